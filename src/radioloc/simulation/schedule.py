"""Schedules of tracking: sessions of links at regular epochs, restricted to visible targets.

A pair of stations is, by the form of path of the kind of measurement, transmitter and receiver (two-way if they are the
same), an empty name and the receiver, or the first and the second station of a baseline (second minus first).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from radioloc.constants import SECONDS_PER_DAY
from radioloc.errors import InputError
from radioloc.measurements.link import Link, canonical_target
from radioloc.measurements.observations import Observations
from radioloc.measurements.physical_model import PhysicalModel
from radioloc.measurements.registry import KINDS, MEASUREMENTS, TIME_TAGS
from radioloc.measurements.target_motion import MotionLike, as_motion
from radioloc.quantities import accepts_quantities, convert_fields
from radioloc.simulation.visibility import AtInfinity, Masks, Sight, Sighted
from radioloc.time import Epochs, epochs_from_strings, utc_to_tai, utc_to_tt
from radioloc.units import set_fields
from radioloc.vectors import Indices, Mask

Pair = tuple[str, str]

_ROUND_TRIP_S = 2.6  # From transmission to reception


def one_way(*stations: str) -> tuple[Pair, ...]:
    """Return pairs of stations that receive the target's own signal.

    Examples
    --------
    >>> from radioloc.simulation import one_way
    >>> one_way("KASHI", "JIAMUSI")
    (('', 'KASHI'), ('', 'JIAMUSI'))
    """
    return tuple(("", station) for station in stations)


def two_way(*stations: str) -> tuple[Pair, ...]:
    """Return pairs of stations that receive their own signal.

    Examples
    --------
    >>> from radioloc.simulation import two_way
    >>> two_way("KASHI", "JIAMUSI")
    (('KASHI', 'KASHI'), ('JIAMUSI', 'JIAMUSI'))
    """
    return tuple((station, station) for station in stations)


def three_way(transmitter: str, *receivers: str) -> tuple[Pair, ...]:
    """Return pairs of one transmitter with other receivers.

    Examples
    --------
    >>> from radioloc.simulation import three_way
    >>> three_way("KASHI", "JIAMUSI", "NEUQUEN")
    (('KASHI', 'JIAMUSI'), ('KASHI', 'NEUQUEN'))
    """
    return tuple((transmitter, receiver) for receiver in receivers)


def all_ranges(*stations: str) -> tuple[Pair, ...]:
    """Return pairs of each station with itself and with every other, in the order of transmitters.

    Examples
    --------
    >>> from radioloc.simulation import all_ranges
    >>> all_ranges("KASHI", "JIAMUSI")
    (('KASHI', 'KASHI'), ('KASHI', 'JIAMUSI'), ('JIAMUSI', 'KASHI'), ('JIAMUSI', 'JIAMUSI'))
    """
    return tuple((sender, receiver) for sender in stations for receiver in stations)


def baselines(*stations: str) -> tuple[Pair, ...]:
    """Return all baselines of stations, six for four stations, in the order of the arguments.

    Examples
    --------
    >>> from radioloc.simulation import baselines
    >>> baselines("TIANMA65", "KUNMING", "URUMQI")
    (('TIANMA65', 'KUNMING'), ('TIANMA65', 'URUMQI'), ('KUNMING', 'URUMQI'))
    """
    return tuple(combinations(stations, 2))


LINKS: dict[str, tuple[str, Callable[..., tuple[Pair, ...]]]] = {
    "two_way": ("transmitter>target>receiver", two_way),
    "three_way": ("transmitter>target>receiver", three_way),
    "all": ("transmitter>target>receiver", all_ranges),
    "one_way": ("target>receiver", one_way),
    "baselines": ("station1<target>station2", baselines),
}
"""Pairings of stations in a session with their form of path; the first of each form is its default."""


@dataclass(frozen=True, slots=True)
class Session:
    """Links with equal settings at regular epochs."""

    kind: str  #: of KINDS, with one target
    #: Stations of each link: `one_way`, `two_way`, `three_way`, `all_ranges`, `baselines`.
    pairs: Sequence[Pair]
    start_utc: str
    stop_utc: str  #: the latest possible epoch; the days from the start to it must not have a leap second
    step_s: float
    sigma_m: float  #: stated standard deviation of the observations
    #: Only one station transmits at a time, the first in `pairs` of those that see the target.
    one_uplink: bool = False
    time_tag: str = "receive"  #: event at the epochs, of TIME_TAGS
    count_s: float = math.nan  #: count interval of Doppler and delay rates
    uplink_hz: float = math.nan  #: frequency of the uplink; NaN if it has no effect
    wavelength_um: float = math.nan  #: wavelength of the downlink, micrometres; NaN if it has no effect
    source: str = ""  #: a quasar of the model in place of the target
    targets: tuple[str, ...] = ()  #: those of several targets that are tracked; all by default

    def __post_init__(self) -> None:
        convert_fields(self)
        targets = (self.targets,) if isinstance(self.targets, str) else tuple(self.targets)
        set_fields(self, pairs=tuple(self.pairs), targets=targets)
        if self.kind not in KINDS:
            raise InputError(f"kind: expected one of {', '.join(KINDS)}, got {self.kind!r}")
        if self.time_tag not in TIME_TAGS:
            raise InputError(f"time_tag: expected one of {', '.join(TIME_TAGS)}, got {self.time_tag!r}")
        if not self.pairs or len(set(self.pairs)) < len(self.pairs):
            raise InputError(f"pairs: expected one or more different pairs of stations, got {self.pairs!r}")
        if MEASUREMENTS[self.kind].form not in {form for form, _ in LINKS.values()}:
            raise InputError(f"kind: expected a measurement of one target, got {self.kind!r}")
        if self.baseline and any(first == second for first, second in self.pairs):
            raise InputError("pairs: expected two different stations of a baseline")
        if self.source and self.targets:
            raise InputError(
                f"source: expected none with targets {', '.join(self.targets)}, got {self.source!r}"
            )
        if self.source and not self.baseline:
            raise InputError(f"source: expected a kind of delay of baselines, got {self.kind!r}")
        for name in ("step_s", "sigma_m"):
            if not (math.isfinite(getattr(self, name)) and getattr(self, name) > 0.0):
                raise InputError(f"{name}: expected a positive number, got {getattr(self, name)!r}")

    @property
    def baseline(self) -> bool:
        """True for delays between two receiving stations."""
        return MEASUREMENTS[self.kind].on_baseline

    def epochs(self) -> Epochs:
        """Return all epochs from start to stop, UTC, to the nearest float; the target may be invisible."""
        limits = epochs_from_strings([self.start_utc, self.stop_utc], "UTC")
        # Dates have a resolution of a nanosecond, the fraction of a day one of 0.01 ns.
        start_s, stop_s = np.round(limits.fraction * SECONDS_PER_DAY, 9)
        length_s = float((limits.jd[1] - limits.jd[0]) * SECONDS_PER_DAY + (stop_s - start_s))
        if length_s < 0.0:
            raise InputError(
                f"stop_utc: expected an epoch after the start {self.start_utc}, got {self.stop_utc}"
            )
        days = utc_to_tai(Epochs.from_jd([limits.jd[0], limits.jd[1] + 1.0], 0.0, "UTC"))
        if days[1].seconds_since(days[0])[0] != (limits.jd[1] + 1.0 - limits.jd[0]) * SECONDS_PER_DAY:
            raise InputError(
                f"a leap second lies on the days from {self.start_utc} to {self.stop_utc}; split the session there"
            )
        steps = np.arange(math.floor(length_s / self.step_s + 1e-9) + 1)
        day, second = np.divmod(np.round(start_s + steps * self.step_s, 9), SECONDS_PER_DAY)
        return Epochs(limits.jd[0] + day, second / SECONDS_PER_DAY, "UTC")


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """Planned observations, n of them, without values."""

    observations: Observations  #: in the order of time; each value is a placeholder of one metre
    sessions: tuple[Session, ...]
    session: NDArray[np.int64]  #: index into sessions, shape (n,)
    slot: NDArray[np.int64]  #: index into all epochs of the session, shape (n,)
    pair: NDArray[np.int64]  #: index into the pairs of the session, shape (n,)

    def select(self, rows: Indices) -> Plan:
        """Return the plan of some observations."""
        columns = self.session[rows], self.slot[rows], self.pair[rows]
        return Plan(self.observations.select(rows), self.sessions, *columns)


@dataclass(frozen=True, slots=True)
class Schedule:
    """Sessions and elevation masks."""

    sessions: Sequence[Session]
    masks: Masks = field(default_factory=Masks)

    def span(self) -> Epochs:
        """Return the start of the first session and the stop of the last, UTC."""
        dates = [date for session in self.sessions for date in (session.start_utc, session.stop_utc)]
        limits = epochs_from_strings(dates, "UTC")
        return limits[[int(limits.mjd.argmin()), int(limits.mjd.argmax())]]

    @accepts_quantities
    def plan(
        self, model: PhysicalModel, targets: MotionLike | Mapping[str, MotionLike], name: str = "lander"
    ) -> Plan:
        """Return the observations at which the target, or each of several by name, is visible.

        A link is measured while the target is visible from its stations, from the transmission of the first signal of
        the measurement to the reception of its last. `name` is that of a single one in the observations. Errors
        are those of :func:`radioloc.simulation.visibility.elevations`, and that of a schedule without visible target.
        """
        return self.planner(model).plan(targets, name)

    def planner(self, model: PhysicalModel) -> Planner:
        """Return the parts that consecutive plans for several targets have in common."""
        if not self.sessions:
            raise InputError("a schedule needs at least one session")
        return Planner(self, model)


@dataclass(frozen=True, slots=True)
class Planner:
    """A schedule with the frames of its stations."""

    schedule: Schedule
    model: PhysicalModel
    # By session, of first and last signals.
    sights: dict[int, tuple[Sight, Sight]] = field(default_factory=dict)

    def plan(self, targets: MotionLike | Mapping[str, MotionLike], name: str = "lander") -> Plan:
        """Return :meth:`Schedule.plan`."""
        sessions = self.schedule.sessions
        cases = self._cases(targets if isinstance(targets, Mapping) else {name: targets})
        rows = [self._rows(*case) for case in cases]
        observations = Observations.concatenate([part for part, _, _ in rows])
        if len(observations) == 0:
            raise InputError(
                "the target is below the horizon or a mask for all links and epochs; `radioloc visibility --start "
                "... --stop ...` lists passes; change times, stations or masks"
            )
        case = np.repeat(np.arange(len(rows)), [len(part) for part, _, _ in rows])
        session = np.array([k for k, _, _ in cases])[case]
        slot, pair = (np.concatenate([part[k] for part in rows]) for k in (1, 2))
        order = np.lexsort((pair, case, observations.epoch.fraction, observations.epoch.jd))
        observations = observations.select(order)
        _refuse_overlaps(observations)
        return Plan(observations, tuple(sessions), session[order], slot[order], pair[order])

    def measured(self, plan: Plan, targets: Mapping[str, MotionLike]) -> Mask:
        """Return the mask of the observations of a plan, with a target in each session, that targets allow, (n,)."""
        measured = [self._measured(number, target) for number, _, target in self._cases(targets)]
        sizes = np.array([of_session.size for of_session in measured])
        widths = np.array([of_session.shape[1] for of_session in measured])[plan.session]
        rows = (np.cumsum(sizes) - sizes)[plan.session] + plan.slot * widths + plan.pair
        return np.concatenate([of_session.ravel() for of_session in measured])[rows]

    def _cases(self, targets: Mapping[str, MotionLike]) -> list[tuple[int, str, Sighted]]:
        """Return numbers of sessions with the names and places of what they track."""
        sessions = enumerate(self.schedule.sessions)
        return [(k, *case) for k, item in sessions for case in _tracked(item, self.model, targets)]

    def _rows(
        self, number: int, name: str, target: Sighted
    ) -> tuple[Observations, NDArray[np.int64], NDArray[np.int64]]:
        """Return the visible part of a session, with the index of the epoch and of the pair of each observation."""
        session = self.schedule.sessions[number]
        slot, pair = np.nonzero(self._measured(number, target))
        part = Observations.from_columns(
            epoch=session.epochs()[slot],
            links=[Link(*stations, session.baseline) for stations in self._ends(session, name)],
            link=pair,
            value_m=1.0,
            sigma_m=session.sigma_m,
            tag=TIME_TAGS.index(session.time_tag),
            kind=KINDS.index(session.kind),
            count_s=session.count_s,
            uplink_hz=session.uplink_hz,
            wavelength_um=session.wavelength_um,
        )
        return part, slot, pair

    def _ends(self, session: Session, target: str) -> list[tuple[str, str, str]]:
        """Return first station, target and second station of the pairs of a session, by the catalogue's names."""
        name = self.model.catalogue.get
        return [(first and name(first).name, target, name(second).name) for first, second in session.pairs]

    def _measured(self, number: int, target: Sighted) -> Mask:
        """Return at which epochs of a session its pairs measure a target, shape (epochs, pairs)."""
        session = self.schedule.sessions[number]
        pairs = [(first or second, second) for first, _, second in self._ends(session, "")]
        stations = list(dict.fromkeys(name for pair in pairs for name in pair))
        ends = np.array([[stations.index(name) for name in pair] for pair in pairs])
        # From the transmission of the first signal of a measurement to the reception of its last.
        lead_s = lag_s = 0.0 if math.isnan(session.count_s) else 0.5 * session.count_s
        if not session.baseline:
            lead_s += 0.0 if session.time_tag == "transmit" else _ROUND_TRIP_S
            lag_s += 0.0 if session.time_tag == "receive" else _ROUND_TRIP_S
        if number not in self.sights:
            tt = utc_to_tt(session.epochs())
            first, last = (Sight(self.model, stations, tt.shifted(shift_s)) for shift_s in (-lead_s, lag_s))
            self.sights[number] = first, last
        first_visible, last_visible = (
            sight.is_visible(target, self.schedule.masks) for sight in self.sights[number]
        )
        visible = first_visible & last_visible
        measured = visible[:, ends[:, 0]] & visible[:, ends[:, 1]]
        if session.one_uplink:
            senders = list(dict.fromkeys(ends[:, 0].tolist()))
            first_seen = np.array(senders)[np.argmax(visible[:, senders], axis=1)]
            measured &= first_seen[:, None] == ends[:, 0]
        return measured


def _tracked(
    session: Session, model: PhysicalModel, targets: Mapping[str, MotionLike]
) -> list[tuple[str, Sighted]]:
    if session.source:
        name = canonical_target(session.source)
        if name not in model.sources:
            raise InputError(
                f"source: {session.source!r} is missing in the lists of [model] sources; add a list"
            )
        return [(name, AtInfinity(model.sources[name]))]
    places = {canonical_target(name): (name, as_motion(item, model)) for name, item in targets.items()}
    for name in session.targets:
        if canonical_target(name) not in places:
            raise InputError(f"session targets: expected names of {', '.join(targets)}, got {name!r}")
    return [places[canonical_target(name)] for name in session.targets or targets]


def _refuse_overlaps(observations: Observations) -> None:
    keys = observations.epoch.jd, observations.epoch.fraction, observations.link, observations.kind
    order = np.lexsort(keys[::-1])
    repeated = np.ones(len(order) - 1, dtype=bool)
    for key in keys:
        repeated &= np.diff(key[order]) == 0
    if repeated.any():
        raise InputError(
            "two sessions measure the same link at the same time; end one before the other begins"
        )
