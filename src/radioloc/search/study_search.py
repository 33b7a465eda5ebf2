"""Completion of a study from its observations; the completed study is then located without a search.

The searches, in this order: a first orbit near a rough one, the transmitters of passes among candidates, a better
a-priori position on the near side, and undocumented manoeuvres.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from radioloc.dynamics import Impulse
from radioloc.jobs.independent_clocks import with_independent_clocks
from radioloc.jobs.one_thread import on_one_blas_thread
from radioloc.jobs.orbit_start import StagedStart
from radioloc.jobs.preparation import build_model, chosen_observations, prepared_arc
from radioloc.jobs.problem import EstimationProblem
from radioloc.jobs.study_targets import targets_in_pa
from radioloc.jobs.usability import usability
from radioloc.labels import USED
from radioloc.lunar.position import LunarPosition
from radioloc.measurements.link import canonical_target
from radioloc.measurements.observations import Observations
from radioloc.results.cards import Card, Field, table
from radioloc.results.result import Result
from radioloc.search.completed_file import Change, completed_text, require_beside
from radioloc.search.first_orbit import Candidate, first_orbits, is_ambiguous
from radioloc.search.manoeuvres import Manoeuvre, find_manoeuvres
from radioloc.search.near_side import improved_positions
from radioloc.search.transmitters import TransmitterPass, compared_transmitters
from radioloc.study.orbiter import Orbiter
from radioloc.study.study import Study
from radioloc.study.study_file import as_study
from radioloc.study.uplinks import Uplink
from radioloc.time import utc_strings

_MAX_PASSES = 12  # passes on a card; ``to_dict`` has all


@dataclass(frozen=True, slots=True, eq=False)
class NearSidePosition:
    """Position on the near side with a better fit than the a-priori one."""

    target: str  # empty for a single target without name
    position: LunarPosition  # mean-Earth axes
    away_m: float  # from the a-priori position

    def keys(self) -> dict[str, Any]:
        """Return the keys of the target in a study file."""
        longitude_deg, latitude_deg, height_m = self.position.selenographic
        return {
            "frame": self.position.frame,
            "longitude_deg": round(longitude_deg, 6),
            "latitude_deg": round(latitude_deg, 6),
            "height_m": round(height_m, 1),
        }


@dataclass(frozen=True, slots=True, eq=False)
class SearchResult(Result):
    """Results of :func:`search`, and the completed study."""

    study: Study  # completed
    orbits: tuple[Candidate, ...] = ()  # first orbits, the best first; the study has the best
    transmitters: tuple[TransmitterPass, ...] = ()  # candidates of each pass
    apriori_positions: tuple[NearSidePosition, ...] = ()
    manoeuvres: tuple[Manoeuvre, ...] = ()
    changes: tuple[Change, ...] = ()  # of the study file

    @property
    def name(self) -> str:
        """Name of the study."""
        return self.study.name

    @property
    def is_usable(self) -> bool:
        """True if the data decide between the candidates for the first orbit and for all transmitters."""
        return not is_ambiguous(self.orbits) and all(item.decided for item in self.transmitters)

    def write(self, path: str | Path) -> Path:
        """Write the completed study beside the study file, whose relative paths it keeps."""
        path = Path(path)
        path.write_text(completed_text(require_beside(path, self.study), self.changes), encoding="utf-8")
        return path

    def card(self) -> Card:
        """Return the card of the search."""
        return Card(self._fields())

    def _fields(self) -> Iterator[Field]:
        yield Field("search", [self.name])
        status = "COMPLETED"
        if not self.changes:
            status = "COMPLETE: the search adds nothing to the study"
        elif not self.is_usable:
            status = "UNDECIDED: the data do not decide between candidates; the best one is used"
        yield Field("status", [status])
        yield Field("orbit", self._orbit_lines())
        yield _transmitter_table(self.transmitters)
        yield Field("position", map(_position_line, self.apriori_positions))
        yield Field("manoeuvre", map(str, self.manoeuvres))

    def _orbit_lines(self) -> Iterator[str]:
        if self.orbits:
            best, *alternatives = self.orbits
            yield f"first orbit from Doppler near the epoch: {best}"
            fit = "as well" if is_ambiguous(self.orbits) else "less well"
            yield from (f"another candidate fits {fit}: {item}" for item in alternatives)

    def to_dict(self) -> dict[str, Any]:
        """Return all results in JSON types."""
        return {
            "name": self.name,
            "decided": self.is_usable,
            "orbits": [item.to_dict() for item in self.orbits],
            "transmitters": [item.to_dict() for item in self.transmitters],
            "apriori_positions": [
                {"target": p.target, **p.keys(), "away_m": p.away_m} for p in self.apriori_positions
            ],
            "manoeuvres": [item.to_dict() for item in self.manoeuvres],
        }


@on_one_blas_thread()
def search(study: Study | str | Path, observations: Observations | None = None) -> SearchResult:
    """Find the first orbit, transmitters, a-priori position and manoeuvres that a study does not state.

    Parameters and errors as :func:`radioloc.locate`, which fits ``search(study).study``.

    Examples
    --------
    >>> import radioloc
    >>> print(radioloc.search.search("examples/apollo15/apollo15.toml"))
    search      apollo15
    status      COMPLETE: the search adds nothing to the study
    """
    original = as_study(study)
    plain = replace(original.observations, transmitters=None, turnarounds=None)
    result = _with_first_orbit(SearchResult(replace(original, observations=plain)), original, observations)
    if plain != original.observations:
        result = _with_transmitters(result, original, observations)
        result = _with_first_orbit(result, original, observations)  # with the true transmitters
    if original.orbiter is None or original.targets:
        return _with_positions(result, observations)
    orbit = original.estimate.orbit
    if not original.lands and (orbit is None or orbit.process_noise is None):
        # Stochastic accelerations absorb manoeuvres.
        return _with_manoeuvres(result, observations)
    return result


def _with_first_orbit(
    result: SearchResult, original: Study, observations: Observations | None
) -> SearchResult:
    target = original.target
    if not isinstance(target, Orbiter) or target.rough is None:
        return result
    model = build_model(original)
    chosen, _ = chosen_observations(result.study, observations, model)
    orbits = first_orbits(target, model, chosen)
    state = orbits[0].state
    keys = {"position_m": state[:3].round(6).tolist(), "velocity_m_s": state[3:].round(6).tolist()}
    change = Change(("target",), keys, ("altitude_m", "inclination_deg", "node_deg"))
    study = replace(result.study, target=target.with_state(state))
    return replace(result, study=study, orbits=orbits, changes=(*result.changes, change))


def _with_transmitters(
    result: SearchResult, original: Study, observations: Observations | None
) -> SearchResult:
    arc, _ = prepared_arc(result.study, observations)
    passes = compared_transmitters(original, arc)
    uplinks = [item.uplink() for item in passes]
    tables = {"uplinks": list(map(_uplink_keys, uplinks))}
    change = Change(("observations",), {}, ("transmitters", "turnarounds"), tables)
    choice = result.study.observations
    study = replace(result.study, observations=replace(choice, uplinks=(*choice.uplinks, *uplinks)))
    return replace(result, study=study, transmitters=tuple(passes), changes=(*result.changes, change))


def _with_positions(result: SearchResult, observations: Observations | None) -> SearchResult:
    study = result.study
    arc, _ = prepared_arc(study, observations)
    constants = arc.model.ephemeris.constants
    estimate = with_independent_clocks(study, study.estimate, arc)
    better = improved_positions(arc, targets_in_pa(study, arc.model), estimate)
    names = {canonical_target(name): name for name in study.targets} or {"": ""}
    positions = {
        names[name]: NearSidePosition(names[name], place.to_axes("ME", constants), away_m)
        for name, (place, away_m) in better.items()
    }
    if not positions:
        return result
    if study.targets:
        targets = {**study.targets, **{name: item.position for name, item in positions.items()}}
        study = replace(study, targets=targets, target=next(iter(targets.values())))
    else:
        study = replace(study, target=positions[""].position)
    changes = [
        Change(("targets", name) if name else ("target",), item.keys(), ("position_m",))
        for name, item in positions.items()
    ]
    return replace(
        result, study=study, apriori_positions=tuple(positions.values()), changes=(*result.changes, *changes)
    )


def _with_manoeuvres(result: SearchResult, observations: Observations | None) -> SearchResult:
    study = result.study
    orbiter = study.orbiter
    assert orbiter is not None
    arc, _ = prepared_arc(study, observations)
    problem = EstimationProblem.from_study(study, arc, study.estimate)
    start = StagedStart.from_model(problem.model, problem.noise.sigma_m)
    if start is None:
        return result
    manoeuvres = find_manoeuvres(start, usability(start.arc)[0].are(USED))
    stated = orbiter.forces.impulses
    impulses = [
        Impulse(f"found_{len(stated) + k}", item.epoch, tuple(item.delta_v_m_s.round(6).tolist()))
        for k, item in enumerate(manoeuvres, 1)
    ]
    forces = replace(orbiter.forces, impulses=(*stated, *impulses))
    study = replace(study, target=replace(orbiter, forces=forces))
    change = Change(("forces",), {}, added={"impulses": list(map(_impulse_keys, impulses))})
    changes = (*result.changes, change) if impulses else result.changes
    return replace(result, study=study, manoeuvres=tuple(manoeuvres), changes=changes)


def _uplink_keys(uplink: Uplink) -> Mapping[str, Any]:
    first, last = (str(utc_strings(moment, 3)[0]) for moment in (uplink.start, uplink.stop))
    keys = {
        "receiver": uplink.receiver,
        "target": uplink.target,
        "start": first,
        "stop": last,
        "transmitter": uplink.transmitter,
        "turnaround": uplink.turnaround and list(uplink.turnaround),
    }
    return {key: value for key, value in keys.items() if value is not None}


def _impulse_keys(impulse: Impulse) -> Mapping[str, Any]:
    return {
        "name": impulse.name,
        "epoch": str(utc_strings(impulse.epoch, 3)[0]),
        "delta_v_m_s": list(impulse.delta_v_m_s),
    }


def _position_line(item: NearSidePosition) -> str:
    longitude_deg, latitude_deg, _ = item.position.selenographic
    target = f"{item.target}: " if item.target else ""
    return (
        f"{target}{longitude_deg:.2f} deg east, {latitude_deg:.2f} deg north fits better than the a-priori "
        f"position, {item.away_m / 1e3:.0f} km away"
    )


def _transmitter_table(passes: Sequence[TransmitterPass]) -> Field:
    """Return the best two candidates for the transmitter of each pass, with their rms."""
    rows = []
    for item in passes:
        best, *alternatives = item.ranking
        second = (alternatives[0], item.size(alternatives[0])) if alternatives else ("-", "-")
        name = best if item.decided else f"{best}?"
        rows.append((f"{item.receiver} {utc_strings(item.span, 0)[0][5:16]}", name, item.size(best), *second))
    notes = [] if all(item.decided for item in passes) else ["? undecided: another fits about as well"]
    heading = ("pass", "selected", "rms", "next best", "rms")
    return table("transmitter", heading, rows, _MAX_PASSES, notes, "the JSON")
