"""Who transmitted, where that is not published: for each pass the candidate that leaves the smallest residuals.

What a station received of a target's coherent answer tells the uplink: stations on other sides of the Earth move
against the target by hundreds of metres a second, each in its own way. One frequency offset per pass is left open. A
turnaround ratio is told in the same way, as it scales the received frequency to that of the uplink.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from radioloc.constants import C_M_S
from radioloc.ephemeris.trajectory import AnyTrajectory
from radioloc.errors import InputError, named
from radioloc.estimation.statistics import TransmitterPass, robust_scale
from radioloc.measurements.evaluation import prepare_predictor
from radioloc.measurements.link import Link
from radioloc.measurements.observations import DOPPLER, Observations
from radioloc.measurements.physical_model import PhysicalModel
from radioloc.measurements.quantised import common_step
from radioloc.study.study import Study
from radioloc.time import utc_strings, utc_to_tai

_Floats = NDArray[np.float64]
_Rows = NDArray[np.intp]

_LOOKED_AT = 200
"""Counts of a pass, evenly spread, whose residuals are looked at."""
_SEES = 0.9
"""Part of these at which a candidate must see the target."""
_OUTLIER = 5.0
"""Spreads beyond which a residual has no part in an rms: a pass may begin before the lock."""
_JUMP_M_S = 3.0
"""Step of the rate, beyond what the counts around it make likely, at which another station may have begun to send."""
_JUMP_ROUNDING_STEPS = 2.5
"""Least jump of rates that are multiples of a step: rounding alone makes steps of one, of medians two."""
_AROUND = 9
"""How many steps these are."""
_LEAST_S = 600.0
"""What is shorter, as before a lock, is no pass of its own: a transmitter does not show in it."""


@dataclass(frozen=True, slots=True, eq=False)
class TransmitterSearch:
    """What candidates are compared with: a model, and where the target is."""

    study: Study
    model: PhysicalModel
    positions_pa_m: _Floats
    trajectory: AnyTrajectory | None = None
    targets: tuple[str, ...] = ()

    @property
    def wanted(self) -> bool:
        """Whether a study names candidates."""
        choice = self.study.observations
        return choice.transmitters is not None or choice.turnarounds is not None

    def resolved(self, observations: Observations) -> Observations:
        """Observations with the transmitter and the turnaround ratio of each pass that fit best.

        Raises
        ------
        InputError
            A candidate is unknown, no candidate sees the target in a pass, or frequencies are not recorded that tell a
            turnaround ratio.
        """
        if not self.wanted:
            return observations
        if not (observations.kind == DOPPLER).any():
            raise InputError(
                "[observations] transmitters: there is no Doppler of a transmitting station; leave it out"
            )
        links = {link: k for k, link in enumerate(observations.links)}
        columns = {name: getattr(observations, name).copy() for name in ("link", "value_m", "wavelength_um")}
        for rows, found, candidates in self._compared(observations):
            if not found.ranking:
                raise InputError(
                    f"[observations] transmitters: none of {', '.join(found.rms_m_s)} sees the target while "
                    f"{found.receiver} received it, {found.first_utc} to {found.last_utc} UTC; name one that does"
                )
            transmitter, turnaround = candidates[found.ranking[0]]
            of_links = [_sent(link, transmitter) for link in observations.links]
            recode = np.array([links.setdefault(link, len(links)) for link in of_links])
            columns["link"][rows] = recode[observations.link[rows]]
            columns["value_m"][rows] = _with_turnaround(observations, rows, turnaround)
            if turnaround is not None:
                down_hz = float(turnaround) * observations.uplink_hz[rows]
                columns["wavelength_um"][rows] = 1e6 * C_M_S / down_hz
        for column in columns.values():
            column.flags.writeable = False
        return replace(observations, links=tuple(links), **columns)

    def passes(self, observations: Observations) -> tuple[TransmitterPass, ...]:
        """How candidates fit where the target is, with what the observations have taken; empty where none are named."""
        return tuple(found for _, found, _ in self._compared(observations)) if self.wanted else ()

    def _compared(
        self, observations: Observations
    ) -> Iterator[tuple[_Rows, TransmitterPass, dict[str, _Candidate]]]:
        """Rows of each pass, its table, and the candidates by their names in it."""
        choice = self.study.observations
        catalogue = self.model.catalogue
        with named("[observations] transmitters:"):
            stations = [catalogue.get(name).name for name in choice.transmitters or ()]
        ratios: list[Fraction] = [_ratio(text) for text in choice.turnarounds or ()]
        tried: Sequence[Fraction | None] = ratios or [None]
        passes = list(_passes(observations, 3600.0 * self.study.estimate.pass_gap_h))
        if not passes:
            return
        looked_at = [
            rows[np.unique(np.linspace(0, len(rows) - 1, _LOOKED_AT).astype(int))] for rows in passes
        ]
        every = np.concatenate(looked_at)
        if ratios and np.isnan(observations.uplink_hz[every] * observations.wavelength_um[every]).any():
            raise InputError(
                "[observations] turnarounds: frequencies up and down are not recorded; leave it out"
            )
        residual_m: dict[str, _Floats] = {}
        named_candidates: dict[str, _Candidate] = {}
        for station in stations or [""]:
            computed_m = self._computed_m(observations, every, station)
            for ratio in tried:
                name = _name(station, ratio)
                named_candidates[name] = station, ratio
                residual_m[name] = _with_turnaround(observations, every, ratio) - computed_m
        ends = np.cumsum([len(rows) for rows in looked_at])
        for rows, some, end in zip(passes, looked_at, ends.tolist(), strict=True):
            mine = slice(end - len(some), end)
            count_s = observations.count_s[some]
            rms_m_s = {name: _rms(column[mine] / count_s) for name, column in residual_m.items()}
            link = observations.links[observations.link[rows[0]]]
            first, last = utc_strings(observations.epoch[rows[[0, -1]]], decimals=0)
            cycle_m = 1e-6 * float(np.median(observations.wavelength_um[rows]))
            yield (
                rows,
                TransmitterPass(
                    receiver=link.receiver,
                    first_utc=str(first),
                    last_utc=str(last),
                    count=len(rows),
                    taken=_name(
                        catalogue.get(link.transmitter).name if stations else "",
                        _nearest(observations, int(rows[0]), ratios),
                    ),
                    rms_m_s=rms_m_s,
                    cycle_m=None if np.isnan(cycle_m) else cycle_m,
                ),
                named_candidates,
            )

    def _computed_m(self, observations: Observations, rows: _Rows, station: str) -> _Floats:
        """Computed values of some rows sent by a station, or by whom they are said to be; NaN where that cannot be."""
        some = observations.select(rows)
        sent = [_sent(link, station) for link in some.links]
        place = {link: k for k, link in enumerate(dict.fromkeys(sent))}
        recode = np.array([place[link] for link in sent], dtype=np.int32)
        some = replace(some, links=tuple(place), link=recode[some.link])
        arc = prepare_predictor(
            self.model, some, self.positions_pa_m, self.study.model.evaluation, self.trajectory, self.targets
        )
        computed = arc.compute(self.positions_pa_m)
        return np.where(computed.usable, computed.value_m, np.nan)


_Candidate = tuple[str, Fraction | None]


def _sent(link: Link, station: str) -> Link:
    """The link with another transmitter, if it has one and another is wanted."""
    return (
        replace(link, transmitter=station) if station and link.transmitter and not link.differenced else link
    )


def _passes(observations: Observations, gap_s: float) -> Iterator[_Rows]:
    """Rows of each pass of Doppler of one target at a receiving station, in order of time.

    A pass ends also where the rate jumps, as it does when the next station takes over the uplink.
    """
    rows = np.flatnonzero(observations.kind == DOPPLER)
    _, of_link = np.unique(
        [f"{one.target}>{one.receiver}" for one in observations.links], return_inverse=True
    )
    tai = utc_to_tai(observations.epoch[rows])
    time_s = tai.seconds_since(tai[np.zeros(len(rows), dtype=np.intp)])
    place = of_link[observations.link[rows]]
    order = np.lexsort((time_s, place))
    rows, time_s = rows[order], time_s[order]
    new = (np.diff(place[order]) != 0) | (np.diff(time_s) > gap_s)
    rate_m_s = observations.value_m[rows] / observations.count_s[rows]
    for part in np.split(np.arange(len(rows)), np.flatnonzero(new) + 1) if len(rows) else ():
        yield from np.split(rows[part], _jumps(time_s[part], rate_m_s[part]))


def _jumps(time_s: _Floats, rate_m_s: _Floats) -> list[int]:
    """Where the rate of a pass jumps, or counts are missing, with at least ten minutes before, between and after."""
    from scipy.ndimage import median_filter

    cuts: list[int] = []
    if len(rate_m_s) > 2:
        step_s = np.maximum(np.diff(time_s), 1e-3)
        usual_m_s = step_s * median_filter(np.diff(rate_m_s) / step_s, _AROUND, mode="nearest")
        # Of a median single counts that are off make no jump, but steps of twice the usual beside them.
        beyond_m_s = np.diff(median_filter(rate_m_s, _AROUND, mode="nearest")) - usual_m_s
        rounding_m_s = _JUMP_ROUNDING_STEPS * common_step(rate_m_s, _JUMP_M_S / _JUMP_ROUNDING_STEPS)
        limit_m_s = np.maximum(
            2.0 * np.abs(usual_m_s), max(_JUMP_M_S, rounding_m_s, _OUTLIER * robust_scale(beyond_m_s, 1))
        )
        gaps = step_s > np.maximum(_LEAST_S, 5.0 * np.median(step_s))  # over which steps say nothing
        for k in (np.flatnonzero((np.abs(beyond_m_s) > limit_m_s) | gaps) + 1).tolist():
            before = time_s[cuts[-1] if cuts else 0]
            if min(time_s[k] - before, time_s[-1] - time_s[k]) >= _LEAST_S:
                cuts.append(k)
    return cuts


def _ratio(text: str) -> Fraction:
    try:
        ratio = Fraction(text)
    except (ValueError, ZeroDivisionError):
        ratio = Fraction(0)
    if not ratio > 0:
        raise InputError(
            f'[observations] turnarounds: {text!r} is no ratio of frequency down to up; write "880/749"'
        )
    return ratio


def _name(station: str, ratio: Fraction | None) -> str:
    return " ".join(part for part in (station, "" if ratio is None else str(ratio)) if part)


def _nearest(observations: Observations, row: int, ratios: Sequence[Fraction]) -> Fraction | None:
    """The ratio that an observation's frequencies are of."""
    if not ratios:
        return None
    now = C_M_S / (1e-6 * observations.wavelength_um[row] * observations.uplink_hz[row])
    return min(ratios, key=lambda ratio: abs(float(ratio) - now))


def _with_turnaround(observations: Observations, rows: _Rows, ratio: Fraction | None) -> _Floats:
    """Values of some rows if the target answered by another ratio, m: the received frequency stays as it is."""
    value_m = observations.value_m[rows]
    if ratio is None:
        return value_m
    whole_m = C_M_S * observations.count_s[rows]
    now = C_M_S / (1e-6 * observations.wavelength_um[rows] * observations.uplink_hz[rows])
    return np.asarray(whole_m - now / float(ratio) * (whole_m - value_m))


def _rms(rate_m_s: _Floats) -> float | None:
    """Rms about an offset, without outliers; none where too few can be computed."""
    known = rate_m_s[~np.isnan(rate_m_s)]
    if len(known) < max(_SEES * len(rate_m_s), 1):
        return None
    off = known - np.median(known)
    near = off[np.abs(off) <= _OUTLIER * max(robust_scale(off, 1), 1e-12)]
    return float(np.sqrt(np.square(near - near.mean()).mean()))
