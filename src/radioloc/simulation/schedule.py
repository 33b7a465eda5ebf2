"""What is to be measured and when: sessions of links at regular epochs, thinned to what can be seen.

A pair of stations means, by kind of measurement, who sends and who receives (``range``, ``doppler``; two-way where they
are the same) or the first and the second station of a baseline (``vlbi_delay``, ``vlbi_delay_rate``: second minus
first).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from radioloc.constants import SECONDS_PER_DAY
from radioloc.earth.stations import StationCatalogue
from radioloc.errors import InputError
from radioloc.measurements.link import Link
from radioloc.measurements.measurement_type import TIME_TAGS
from radioloc.measurements.observations import BASELINE_KINDS, Observations
from radioloc.measurements.physical_model import PhysicalModel
from radioloc.measurements.registry import KINDS
from radioloc.simulation.visibility import Masks, Target, seen
from radioloc.time import Epochs, epochs_from_strings, utc_to_tai, utc_to_tt

Pair = tuple[str, str]
"""Transmitter and receiver, or first and second station of a baseline."""

_ROUND_TRIP_S = 2.6
"""Light time to the Moon and back; how long before its reception a signal was sent, or after its sending received."""


def two_way(*stations: str) -> tuple[Pair, ...]:
    """Pairs of stations that receive what they sent."""
    return tuple((station, station) for station in stations)


def three_way(transmitter: str, *receivers: str) -> tuple[Pair, ...]:
    """Pairs of one transmitter with other receivers."""
    return tuple((transmitter, receiver) for receiver in receivers)


def all_ranges(*stations: str) -> tuple[Pair, ...]:
    """Pairs of each station with itself and with every other, transmitters in the order given."""
    return tuple((sender, receiver) for sender in stations for receiver in stations)


def baselines(*stations: str) -> tuple[Pair, ...]:
    """All baselines of some stations, six of four; of each, the first is the one named earlier."""
    return tuple(combinations(stations, 2))


@dataclass(frozen=True, slots=True)
class Session:
    """Links measured in the same way at regular epochs.

    Parameters
    ----------
    kind : {"range", "vlbi_delay", "doppler", "vlbi_delay_rate"}
        As :data:`radioloc.measurements.registry.KINDS`.
    pairs : sequence of (str, str)
        Stations of each link (:func:`two_way`, :func:`three_way`, :func:`all_ranges`, :func:`baselines`).
    start_utc, stop_utc : str
        First epoch and the latest possible one. No leap second may lie on the days in between.
    step_s : float
        From epoch to epoch, s.
    sigma_m : float
        Standard deviation that the observations are to state, m.
    one_uplink : bool
        Only one station sends at a time: of those that see the target the one that comes first in `pairs`; the links of
        the others wait.
    time_tag : {"receive", "transmit", "bounce"}
        Event that the epochs belong to; ``receive`` for delays, their rates and Doppler.
    count_s : float
        Count interval of Doppler and delay rates, s.
    uplink_hz, wavelength_um : float
        Of the signal on its way up (Hz) and down (micrometres); NaN where it does not matter.

    Raises
    ------
    InputError
        Something is not usable as it stands.
    """

    kind: str
    pairs: Sequence[Pair]
    start_utc: str
    stop_utc: str
    step_s: float
    sigma_m: float
    one_uplink: bool = False
    time_tag: str = "receive"
    count_s: float = math.nan
    uplink_hz: float = math.nan
    wavelength_um: float = math.nan

    def __post_init__(self) -> None:
        object.__setattr__(self, "pairs", tuple(self.pairs))
        if self.kind not in KINDS:
            raise InputError(f"kind {self.kind!r} is not known; use {', '.join(KINDS)}")
        if self.time_tag not in TIME_TAGS:
            raise InputError(f"time_tag {self.time_tag!r} is not known; use {', '.join(TIME_TAGS)}")
        if not self.pairs or len(set(self.pairs)) < len(self.pairs):
            raise InputError(
                f"pairs is {self.pairs!r}; a session needs at least one pair of stations, none twice"
            )
        if self.kind in BASELINE_KINDS and any(first == second for first, second in self.pairs):
            raise InputError("a baseline has two different stations")
        for name in ("step_s", "sigma_m"):
            if not (math.isfinite(getattr(self, name)) and getattr(self, name) > 0.0):
                raise InputError(f"{name} is {getattr(self, name)!r}; give a positive number")

    def epochs(self) -> Epochs:
        """All epochs from start to stop, seen or not, UTC, to the nearest float.

        Raises
        ------
        InputError
            The stop is before the start, or a leap second lies on one of the days.
        """
        limits = epochs_from_strings([self.start_utc, self.stop_utc], "UTC")
        # A start is meant to the nanosecond at most; a float of the fraction of a day is 0.01 ns wide.
        start_s, stop_s = np.round(limits.fraction * SECONDS_PER_DAY, 9)
        length_s = float((limits.jd[1] - limits.jd[0]) * SECONDS_PER_DAY + (stop_s - start_s))
        if length_s < 0.0:
            raise InputError(f"the session starts at {self.start_utc} but stops earlier, at {self.stop_utc}")
        days = utc_to_tai(Epochs.from_jd([limits.jd[0], limits.jd[1] + 1.0], 0.0, "UTC"))
        if days[1].seconds_since(days[0])[0] != (limits.jd[1] + 1.0 - limits.jd[0]) * SECONDS_PER_DAY:
            raise InputError(
                f"a leap second lies on the days from {self.start_utc} to {self.stop_utc}; leave its day out"
            )
        steps = np.arange(math.floor(length_s / self.step_s + 1e-9) + 1)
        day, second = np.divmod(np.round(start_s + steps * self.step_s, 9), SECONDS_PER_DAY)
        return Epochs(limits.jd[0] + day, second / SECONDS_PER_DAY, "UTC")


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """What is to be measured: observations without their values.

    Parameters
    ----------
    observations : Observations
        In the order of time; each value is one metre and means nothing.
    sessions : tuple of Session
        The sessions that they belong to.
    session : ndarray of int, shape (n,)
        Index into `sessions`.
    slot : ndarray of int, shape (n,)
        Index into the epochs of the session, seen or not.
    """

    observations: Observations
    sessions: tuple[Session, ...]
    session: NDArray[np.int64]
    slot: NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Schedule:
    """Sessions and what limits them.

    Parameters
    ----------
    sessions : sequence of Session
    masks : Masks
        Elevations below which nothing is measured.
    """

    sessions: Sequence[Session]
    masks: Masks = field(default_factory=Masks)

    def plan(self, model: PhysicalModel, target_pa_m: Target, target: str = "lander") -> Plan:
        """Epochs and links of what can be seen.

        A link is measured when both its stations see the target, from the sending of the measurement's first signal to
        the reception of its last.

        Parameters
        ----------
        model : PhysicalModel
            Where everything is.
        target_pa_m : ndarray, shape (3,), or Trajectory
            The point on the Moon, principal axes, m, or a spacecraft no farther than the Moon.
        target : str
            Its name.

        Raises
        ------
        InputError
            There is no session, nothing can be seen, or two sessions hold the same link at the same time.
        StationError, CoverageError
            As :func:`radioloc.simulation.visibility.elevations`.
        """
        if not self.sessions:
            raise InputError("a schedule needs at least one session")
        rows = [self._rows(i, session, model, target_pa_m, target) for i, session in enumerate(self.sessions)]
        observations = Observations.concatenate([part for part, _, _ in rows])
        if len(observations) == 0:
            raise InputError("nothing can be seen in any session; check times, stations and masks")
        session, slot, pair = (
            np.concatenate(columns)
            for columns in (
                [np.full(len(part), i) for i, (part, _, _) in enumerate(rows)],
                [slot for _, slot, _ in rows],
                [pair for _, _, pair in rows],
            )
        )
        order = np.lexsort((pair, session, observations.epoch.fraction, observations.epoch.jd))
        observations = observations.select(order)
        _refuse_overlaps(observations)
        return Plan(observations, tuple(self.sessions), session[order], slot[order])

    def _rows(
        self,
        index: int,
        session: Session,
        model: PhysicalModel,
        target_pa_m: Target,
        target: str,
    ) -> tuple[Observations, NDArray[np.int64], NDArray[np.int64]]:
        utc = session.epochs()
        pairs = _canonical(session.pairs, model.catalogue)
        stations = tuple(dict.fromkeys(name for pair in pairs for name in pair))
        place = {name: k for k, name in enumerate(stations)}
        ends = np.array([[place[first], place[second]] for first, second in pairs])
        can_see = self._seen(session, model, target_pa_m, stations, utc)
        measured = can_see[:, ends[:, 0]] & can_see[:, ends[:, 1]]
        if session.one_uplink:
            senders = list(dict.fromkeys(ends[:, 0].tolist()))
            first_seen = np.array(senders)[np.argmax(can_see[:, senders], axis=1)]
            measured &= first_seen[:, None] == ends[:, 0]
        slot, pair = np.nonzero(measured)
        differenced = session.kind in BASELINE_KINDS
        part = Observations.from_columns(
            epoch=utc[slot],
            links=[Link(first, target, second, differenced) for first, second in pairs],
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

    def _seen(
        self,
        session: Session,
        model: PhysicalModel,
        target_pa_m: Target,
        stations: tuple[str, ...],
        utc: Epochs,
    ) -> NDArray[np.bool_]:
        """Whether each station sees the target throughout the measurement at each epoch, shape (n, k)."""
        half_s = 0.0 if math.isnan(session.count_s) else 0.5 * session.count_s
        before_s = after_s = half_s
        if session.kind not in BASELINE_KINDS:
            before_s += 0.0 if session.time_tag == "transmit" else _ROUND_TRIP_S
            after_s += 0.0 if session.time_tag == "receive" else _ROUND_TRIP_S
        tt = utc_to_tt(utc)
        first, last = (
            seen(model, target_pa_m, stations, tt.shifted(shift_s), self.masks)
            for shift_s in (-before_s, after_s)
        )
        return first & last


def _canonical(pairs: Sequence[Pair], catalogue: StationCatalogue) -> list[Pair]:
    return [(catalogue.get(first).name, catalogue.get(second).name) for first, second in pairs]


def _refuse_overlaps(observations: Observations) -> None:
    keys = observations.epoch.jd, observations.epoch.fraction, observations.link, observations.kind
    order = np.lexsort(keys[::-1])
    same = np.ones(len(order) - 1, dtype=bool)
    for key in keys:
        same &= np.diff(key[order]) == 0
    if same.any():
        raise InputError("two sessions measure the same link at the same time; let one of them end before")
