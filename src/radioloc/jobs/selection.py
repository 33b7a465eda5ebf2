"""Selection of observations for a study, with reasons for the rest, and their division into arcs.

Consecutive counts of Doppler are joined on request: their cycles add up, and only resolution is lost.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import replace

import numpy as np

from radioloc.earth.stations import StationCatalogue
from radioloc.errors import InputError, error_context
from radioloc.measurements.link import canonical_target
from radioloc.measurements.observations import Observations
from radioloc.measurements.registry import KINDS, is_integrated
from radioloc.quantities import FloatLike, accepts_quantities
from radioloc.study.observation_choice import ObservationChoice, link_stations
from radioloc.time import tai_to_utc, utc_to_tai
from radioloc.vectors import Floats, Mask

DEFAULT_HOURS = (12.0, 24.0, 48.0)  # Arcs of Wang et al. (2021), table 1.

EPOCH_ROUNDING_S = 1e-9  # Both ends of a span belong to it; epochs are rounded to 1e-11 s

_QUASAR_HINT = "if one is a quasar, name a list that has it: [model] sources"
_GAP_TOLERANCE_S = 1e-6  # Largest gap between consecutive counts; 2 mm at 2 km/s
_COMMON_COLUMNS = ("link", "kind", "tag", "count_s", "uplink_hz", "wavelength_um", "ramped")
"""Columns with equal values in joined counts; ``uplink_hz`` of ramped counts converts their cycles to metres."""


def select_observations(
    observations: Observations,
    choice: ObservationChoice,
    catalogue: StationCatalogue,
    positions: Collection[str] = (),
    sources: Collection[str] = (),
    name: str | None = None,
) -> tuple[Observations, dict[str, int]]:
    """Return the selected observations of a study, in input order, and the number of others by reason."""
    mask, left_out = selected(observations, choice, catalogue, positions, sources, name)
    # Tables are not written to, so a complete one need not be copied.
    chosen = observations.select(mask) if left_out else observations
    if choice.doppler_average_s is not None:
        chosen, remainder = with_averaged_counts(chosen, choice.doppler_average_s)
        if remainder:
            left_out[f"left over from averages of Doppler over {choice.doppler_average_s:g} s"] = remainder
        if not len(chosen):
            raise InputError(
                f"[observations] doppler_average_s: expected a length that counts without gaps reach, got "
                f"{choice.doppler_average_s:g} s; give a shorter one"
            )
    return chosen, left_out


def targets_of(observations: Observations) -> set[str]:
    """Return the targets of all links of observations."""
    return {canonical_target(name) for link in observations.links for name in link.targets}


def require_targets(present: Collection[str], names: Iterable[str]) -> None:
    """Refuse a name of ``target_names`` that is not among the targets of the files."""
    if unknown := [name for name in map(canonical_target, names) if name not in present]:
        raise InputError(
            f"[observations] target_names: expected targets of the files ({', '.join(sorted(present))}), "
            f"got {unknown[0]}"
        )


def with_target_names(
    observations: Observations, names: Mapping[str, str], *, complete: bool = True
) -> Observations:
    """Return observations with other names of targets than in the files; an unknown name is an error.

    A part of the observations, which is not `complete`, may lack targets that are named.
    """
    if not names:
        return observations
    if complete:
        require_targets(targets_of(observations), names)
    new_names = {canonical_target(old): canonical_target(new) for old, new in names.items()}

    def renamed(name: str) -> str:
        return new_names.get(canonical_target(name), name) if name else ""

    links = (
        replace(link, target=renamed(link.target), second_target=renamed(link.second_target))
        for link in observations.links
    )
    ramps = replace(observations.ramps, stations=tuple(map(renamed, observations.ramps.stations)))
    # Concatenation merges links that are now equal.
    return Observations.concatenate([replace(observations, links=tuple(links), ramps=ramps)])


def selected(
    observations: Observations,
    choice: ObservationChoice,
    catalogue: StationCatalogue,
    positions: Collection[str] = (),
    sources: Collection[str] = (),
    name: str | None = None,
    *,
    complete: bool = True,
) -> tuple[Mask, dict[str, int]]:
    """Return the mask of the selected observations, shape (n,), and the number of others by reason.

    A part of the observations, which is not `complete`, may lack targets and stations that are named.
    """
    left_out: dict[str, int] = {}
    is_kept = np.ones(len(observations), dtype=bool)

    def keep(mask: Mask, reason: str) -> None:
        nonlocal is_kept
        count = int((is_kept & ~mask).sum())
        if count:
            left_out[reason] = count
        is_kept = is_kept & mask

    keep(_target_mask(observations, choice.targets, positions, sources, name, complete), "other target")
    keep(_station_mask(observations, choice.stations, catalogue, complete), "other station")
    keep(_type_mask(observations, choice.types), "other type")
    if len(observations):
        keep(_within_time(observations, is_kept, choice), "outside the time span")
    if complete and not is_kept.any():
        counts = "; ".join(f"{count} {reason}" for reason, count in left_out.items()) or "the files hold none"
        raise InputError(
            f"no observations left ({counts}); change targets, stations, types, start, stop or hours"
        )
    return is_kept, left_out


def _target_mask(
    observations: Observations,
    targets: tuple[str, ...] | None,
    positions: Collection[str],
    sources: Collection[str],
    name: str | None,
    complete: bool,
) -> Mask:
    of_link = [
        {canonical_target(name) for name in link.targets} - set(sources) for link in observations.links
    ]
    present = sorted(set().union(*(of_link[i] for i in np.unique(observations.link))))
    named = [canonical_target(name) for name in positions]
    if not named and targets is None and name is not None and canonical_target(name) in present:
        targets = (name,)  # the name of the only [target] selects among several
    if targets is None and not named:
        if len(present) > 1:
            raise InputError(
                f"expected observations of one target, as the study gives one position, got {', '.join(present)}; name "
                f'one, [target] name = "{present[0]}", or give the position of each as [targets.NAME]; {_QUASAR_HINT}'
            )
        return np.ones(len(observations), dtype=bool)
    chosen = {canonical_target(name) for name in targets} if targets is not None else set(named)
    key = "[targets]" if targets is None else "[observations] targets"
    missing = sorted(chosen - set(present))
    if complete and missing:
        raise InputError(
            f"{key}: no observation of {', '.join(missing)}; the files have {', '.join(present) or 'none'}"
        )
    if named and not chosen <= set(named):
        raise InputError(
            f"{key}: expected targets with positions, got {', '.join(sorted(chosen - set(named)))}; give it "
            f"as [targets.NAME], beside {', '.join(named)}; {_QUASAR_HINT}"
        )
    if not named and len(chosen) > 1:
        raise InputError(
            f"{key}: the study gives one position, but several targets are named: {', '.join(sorted(chosen))}; "
            "name one, or give the position of each as [targets.NAME]"
        )
    return np.array([names <= chosen for names in of_link], dtype=bool)[observations.link]


def _type_mask(observations: Observations, types: tuple[str, ...] | None) -> Mask:
    if types is None:
        return np.ones(len(observations), dtype=bool)
    if unknown := [name for name in types if name not in KINDS]:
        raise InputError(f"[observations] types: expected {', '.join(KINDS)}, got {unknown[0]!r}")
    return np.isin(observations.kind, [KINDS.index(name) for name in types])


def _station_mask(
    observations: Observations, stations: tuple[str, ...] | None, catalogue: StationCatalogue, complete: bool
) -> Mask:
    if stations is None:
        return np.ones(len(observations), dtype=bool)
    with error_context("[observations] stations:"):
        members = {name: {station.name for station in catalogue.members(name)} for name in stations}
    ends = link_stations(observations.links, catalogue)
    present, chosen = set[str]().union(*ends), set[str]().union(*members.values())
    missing = sorted(name for name, names in members.items() if not names & present)
    if complete and missing:
        raise InputError(
            f"[observations] stations: no observation by {', '.join(missing)}; "
            f"the files have {', '.join(sorted(present))}"
        )
    return np.array([names <= chosen for names in ends], dtype=bool)[observations.link]


def _within_time(observations: Observations, selected_rows: Mask, choice: ObservationChoice) -> Mask:
    mask = np.ones(len(observations), dtype=bool)
    if choice.stop is not None:
        since_stop_s = utc_to_tai(observations.epoch).seconds_since(utc_to_tai(choice.stop))
        mask = since_stop_s <= EPOCH_ROUNDING_S
    if choice.start is None and (choice.hours is None or not (selected_rows & mask).any()):
        return mask
    since_s = since_start_s(observations, choice, selected_rows & mask)
    mask &= since_s >= -EPOCH_ROUNDING_S
    if choice.hours is not None:
        mask &= since_s <= 3600.0 * choice.hours + EPOCH_ROUNDING_S
    return mask


def since_start_s(
    observations: Observations, choice: ObservationChoice, selected_rows: Mask | None = None
) -> Floats:
    """Return the time since the study's start, or else since the first observation, of the selected ones, s."""
    epoch = utc_to_tai(observations.epoch)
    if choice.start is not None:
        return epoch.seconds_since(utc_to_tai(choice.start))
    candidates = epoch if selected_rows is None else epoch[selected_rows]
    return epoch.seconds_since(candidates[int(np.lexsort((candidates.fraction, candidates.jd))[0])])


@accepts_quantities
def arc_lengths(hours: Iterable[FloatLike] | FloatLike, choice: ObservationChoice) -> list[float]:
    """Return the lengths of arcs, each once, the shortest first, h; no length or one below zero is an error."""
    lengths = sorted({float(length) for length in np.atleast_1d(np.asarray(hours, dtype=np.float64))})
    if not lengths:
        raise InputError("no arc to fit; give at least one length in hours")
    for length in lengths:
        replace(choice, hours=length)  # checks the length
    return lengths


def with_averaged_counts(observations: Observations, average_s: float) -> tuple[Observations, int]:
    """Return sums of counts without gaps over `average_s`, a multiple of the interval, and the number rejected."""
    with np.errstate(invalid="ignore"):
        shorter = is_integrated(observations.kind) & (observations.count_s < average_s - _GAP_TOLERANCE_S)
    rows = np.flatnonzero(shorter)
    if not len(rows):
        return observations, 0
    number = np.rint(average_s / observations.count_s[rows]).astype(np.int64)
    wrong = np.abs(number * observations.count_s[rows] - average_s) > _GAP_TOLERANCE_S
    if wrong.any():
        row = int(rows[np.argmax(wrong)])
        raise InputError(
            f"[observations] doppler_average_s: expected a multiple of the count interval "
            f"{observations.count_s[row]:g} s ({observations.origin(row)}), got {average_s:g} s"
        )
    tai = utc_to_tai(observations.epoch[rows])
    since_s = tai.seconds_since(tai[:1])
    columns = [np.nan_to_num(getattr(observations, name)[rows]) for name in _COMMON_COLUMNS]
    order = np.lexsort((since_s, *columns))
    rows, number, since_s = rows[order], number[order], since_s[order]
    # Runs of counts without gaps are divided into intervals of `number` counts from their first.
    meets = np.abs(np.diff(since_s) - observations.count_s[rows[1:]]) < _GAP_TOLERANCE_S
    for column in columns:
        meets &= np.diff(column[order]) == 0
    begins = np.concatenate([[True], ~meets])
    run = np.cumsum(begins) - 1
    first = np.flatnonzero(begins)
    place = np.arange(len(rows)) - first[run]
    complete = place - place % number + number <= np.bincount(run)[run]
    starts = np.flatnonzero((place % number == 0) & complete)
    if not len(starts):
        return observations.select(~shorter), len(rows)
    interval = np.cumsum((place % number == 0) & complete)[complete] - 1
    value_m, variance_m2 = (
        np.bincount(interval, weights=column[rows[complete]]).astype(np.float64)
        for column in (observations.value_m, observations.sigma_m**2)
    )
    half_s = 0.5 * (number[starts] - 1) * observations.count_s[rows[starts]]
    middle = observations.select(rows[starts + number[starts] // 2])
    joined = replace(
        middle,
        epoch=tai_to_utc(tai[order][starts].shifted(half_s)),
        value_m=value_m,
        sigma_m=np.sqrt(variance_m2),
        count_s=np.full(len(starts), average_s),
        file=observations.file[rows[starts]],
        line=observations.line[rows[starts]],
    )
    other_rows = np.flatnonzero(~shorter)
    averaged = Observations.concatenate([joined, observations.select(other_rows)])
    in_order = np.argsort(np.concatenate([rows[starts], other_rows]), kind="stable")
    return averaged.select(in_order), int((~complete).sum())
