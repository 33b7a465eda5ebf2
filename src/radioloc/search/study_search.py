"""Completion of a study from its observations; the completed study is then located without a search.

The searches, in this order: a first orbit near a rough one, the transmitters of passes among candidates, and
undocumented manoeuvres.

The edited study file keeps its comments.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import ModuleType
from typing import Any

from radioloc.dynamics import Impulse
from radioloc.errors import InputError
from radioloc.jobs.one_thread import on_one_blas_thread
from radioloc.jobs.orbit_start import StagedStart
from radioloc.jobs.preparation import build_model, chosen_observations, prepared_arc, usability
from radioloc.jobs.problem import EstimationProblem
from radioloc.labels import USED
from radioloc.lazy import optional
from radioloc.measurements.observations import Observations
from radioloc.results.cards import Card, Field, table
from radioloc.results.result import Result
from radioloc.search.first_orbit import Candidate, first_orbits, is_ambiguous
from radioloc.search.manoeuvres import Manoeuvre, find_manoeuvres
from radioloc.search.transmitters import TransmitterPass, compared_transmitters
from radioloc.study.observation_choice import Uplink
from radioloc.study.orbiter import Orbiter
from radioloc.study.study import Study
from radioloc.study.study_file import as_study
from radioloc.time import utc_strings


@dataclass(frozen=True, slots=True)
class Change:
    """Change of one table of a study file."""

    table: tuple[str, ...]  # its name in parts
    values: Mapping[str, Any]  # keys that are set
    removed: tuple[str, ...] = ()  # keys that are removed
    added: Mapping[str, Sequence[Mapping[str, Any]]] = field(default_factory=dict)  # to arrays of tables

    def apply(self, content: Any) -> None:
        """Change a document, which is a mapping of mappings."""
        for name in self.table:
            if name not in content:
                content[name] = {}
            content = content[name]
        for key in self.removed:
            content.pop(key, None)
        for key, value in self.values.items():
            content[key] = value
        for key, tables in self.added.items():
            content[key] = [*content.get(key, ()), *map(dict, tables)]


def require_beside(path: Path, study: Study) -> Path:
    """Return the file of a study; InputError unless a completed study can be written beside it."""
    source = study.path
    if source is None:
        raise InputError(
            f"{path}: expected a study from a file, got one from Python; use the `study` of the result"
        )
    if path.absolute().parent.resolve() != source.absolute().parent.resolve():
        raise InputError(
            f"{path}: expected a file in the folder of {source}, to which paths in the study are relative"
        )
    _tomlkit()
    return source


def _tomlkit() -> ModuleType:
    return optional("tomlkit", "completed studies are written by TOML Kit, which is not installed;", "search")


def completed_text(source: Path, changes: Iterable[Change]) -> str:
    """Return the text of a study file with some changes; InputError if it cannot be edited."""
    tomlkit = _tomlkit()
    text = source.read_text(encoding="utf-8-sig")
    document, expected = tomlkit.parse(text), tomllib.loads(text)
    for change in changes:
        change.apply(document)
        change.apply(expected)
    completed = str(tomlkit.dumps(document))
    if tomllib.loads(completed) != expected:
        raise InputError(
            f"{source}: expected tables that can be edited, got others; enter by hand: {expected}"
        )
    return completed


_MAX_PASSES = 12  # passes on a card; ``to_dict`` has all


@dataclass(frozen=True, slots=True, eq=False)
class SearchResult(Result):
    """Results of :func:`search`, and the completed study."""

    study: Study  # completed
    orbits: tuple[Candidate, ...] = ()  # first orbits, the best first; the study has the best
    transmitters: tuple[TransmitterPass, ...] = ()  # candidates of each pass
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
            "manoeuvres": [item.to_dict() for item in self.manoeuvres],
        }


@on_one_blas_thread()
def search(study: Study | str | Path, observations: Observations | None = None) -> SearchResult:
    """Find the first orbit, transmitters and manoeuvres that a study does not state.

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
    orbit, is_single = original.estimate.orbit, original.orbiter is not None and not original.targets
    if is_single and not original.landers and (orbit is None or orbit.process_noise is None):
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
    predictor, _ = prepared_arc(result.study, observations)
    passes = compared_transmitters(original, predictor)
    uplinks = [item.uplink() for item in passes]
    tables = {"uplinks": list(map(_uplink_keys, uplinks))}
    change = Change(("observations",), {}, ("transmitters", "turnarounds"), tables)
    choice = result.study.observations
    study = replace(result.study, observations=replace(choice, uplinks=(*choice.uplinks, *uplinks)))
    return replace(result, study=study, transmitters=tuple(passes), changes=(*result.changes, change))


def _with_manoeuvres(result: SearchResult, observations: Observations | None) -> SearchResult:
    study = result.study
    orbiter = study.orbiter
    assert orbiter is not None
    predictor, _ = prepared_arc(study, observations)
    problem = EstimationProblem.from_study(study, predictor, study.estimate)
    start = StagedStart.from_model(problem.model, problem.noise.sigma_m)
    if start is None:
        return result
    manoeuvres = find_manoeuvres(start, usability(start.part.predictor)[0].are(USED))
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
