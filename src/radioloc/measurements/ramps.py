"""The frequencies of deep-space links: ramps, in which stations transmit, piece by piece linear in time, and bands.

A coherent measurement counts cycles of the transmitted frequency f_T. In metres, by the reference frequency f_0 of the
observation, Doppler over the count interval T is c T less c / f_0 times the integral of f_T from t1 at its start to t1
at its end, and a range is c / f_0 times the integral from t1 to t3. Both are the length of the light path, or its
change, less c / f_0 times the integral of f_T - f_0 up to the transmission at t1, and need no light time from the user.

Source: Moyer (2003), sections 13.3 and 13.5; of the bands, S, X and Ka, and the ratios by which a transponder
multiplies the uplink's frequency, DSN Telecommunications Link Design Handbook (810-005), module 201, tables of channels
and turnaround ratios, and Moyer's table 13-1.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from radioloc.constants import C_M_S
from radioloc.errors import InputError
from radioloc.measurements.resolution import is_single_precision
from radioloc.media.status import Status
from radioloc.quantities import accepts_quantities
from radioloc.time import Epochs, tai_to_tt, tai_to_utc, utc_strings, utc_to_tai
from radioloc.vectors import Floats

UPLINK = {"S": 221, "X": 749, "Ka": 3599}  # uplinks of one channel are to each other as these numbers
DOWNLINK = {"S": 240, "X": 880, "Ka": 3344}  # coherent downlinks of the channel, on the scale of its uplinks
DOWNLINK_LIMITS_HZ = {"S": (2.20e9, 2.31e9), "X": (8.40e9, 8.50e9), "Ka": (31.8e9, 32.3e9)}

_TOLERANCE_S = 1e-6  # between contiguous ramps: a station's frequency is set to the microsecond
_TOLERANCE_HZ = 1e-3
_MAX_STEP_FRACTION = 0.01  # of the frequency, by which it may step within one signal


@dataclass(frozen=True, slots=True, eq=False)
class Ramps:
    """Pieces of the transmitted frequency, by the transmitting station's clock; :meth:`Ramps.of` checks them.

    Parameters
    ----------
    stations : tuple of str
        Names of the transmitting stations, each once.
    station : ndarray of int, shape (n,)
        Index into ``stations``.
    start : Epochs
        Beginnings, TAI, n epochs.
    duration_s : ndarray, shape (n,)
        How long each lasts, s.
    frequency_hz, rate_hz_s : ndarray, shape (n,)
        Transmitted frequency at the beginning, Hz, and its rate, Hz/s.
    """

    stations: tuple[str, ...]
    station: NDArray[np.int32]
    start: Epochs
    duration_s: Floats
    frequency_hz: Floats
    rate_hz_s: Floats

    @classmethod
    def none(cls) -> Ramps:
        """No ramps."""
        nothing = np.zeros(0)
        return cls((), np.zeros(0, np.int32), Epochs(nothing, nothing, "TAI"), nothing, nothing, nothing)

    @classmethod
    @accepts_quantities
    def of(
        cls,
        station: Sequence[str],
        start: Epochs,
        stop: Epochs,
        frequency_hz: Floats,
        rate_hz_s: Floats,
    ) -> Ramps:
        """Ramps of named stations, in any order; of those that are there twice, one is kept.

        Parameters
        ----------
        station : sequence of str
            The transmitting station of each.
        start, stop : Epochs
            UTC, by the station's clock.
        frequency_hz, rate_hz_s : array_like
            At the beginning, Hz; Hz/s.

        Raises
        ------
        InputError
            A ramp ends before it begins, is no radio frequency, or contradicts another at the same time.
        """
        start.require("UTC")
        stop.require("UTC")
        if is_single_precision(
            frequency_hz
        ):  # an error of the frequency is one of the range rate, 10 m/s and more
            raise InputError(
                "frequency_hz is of single precision, which rounds to hundreds of hertz; give doubles"
            )
        begin, names = utc_to_tai(start), tuple(dict.fromkeys(station))
        code = np.array([names.index(name) for name in station], dtype=np.int32)
        duration_s = utc_to_tai(stop).seconds_since(begin)
        f_hz, rate = np.asarray(frequency_hz, dtype=np.float64), np.asarray(rate_hz_s, dtype=np.float64)
        wrong = ~((duration_s >= 0.0) & (f_hz > 1e6) & (f_hz < 1e12) & np.isfinite(rate))
        if wrong.any():
            k = int(np.argmax(wrong))
            raise InputError(
                f"ramp of {station[k]} at {utc_strings(start[k])[0]} lasts {duration_s[k]:g} s at {f_hz[k]!r} Hz, "
                f"{rate[k]!r} Hz/s; it must end after it begins, and be 1e6 to 1e12 Hz"
            )
        return cls(names, code, begin, duration_s, f_hz, rate)._in_order()

    def __len__(self) -> int:
        return len(self.duration_s)

    def __repr__(self) -> str:
        return f"<Ramps {len(self)} of {', '.join(self.stations) or 'no station'}>"

    @property
    def start_utc(self) -> Epochs:
        """Beginnings in UTC."""
        return _to_nanosecond(tai_to_utc(self.start))

    @property
    def stop_utc(self) -> Epochs:
        """Ends in UTC."""
        return _to_nanosecond(tai_to_utc(self.start.shifted(self.duration_s)))

    @staticmethod
    def concatenate(parts: Sequence[Ramps]) -> Ramps:
        """Join ramps; an InputError where two contradict each other."""
        parts = [part for part in parts if len(part)]
        if len({id(part) for part in parts}) <= 1:
            return parts[0] if parts else Ramps.none()
        names = tuple(dict.fromkeys(name for part in parts for name in part.stations))
        code = [np.array([names.index(n) for n in part.stations], np.int32)[part.station] for part in parts]
        return Ramps(
            names,
            np.concatenate(code),
            Epochs.concatenate([part.start for part in parts]),
            *(
                np.concatenate([getattr(part, name) for part in parts])
                for name in ("duration_s", "frequency_hz", "rate_hz_s")
            ),
        )._in_order()

    def _in_order(self) -> Ramps:
        """By station and time, each until the next begins."""
        order = np.lexsort((self.start.fraction, self.start.jd, self.station))
        order = order[self.duration_s[order] > _TOLERANCE_S]
        start, station, duration_s = self.start[order], self.station[order], self.duration_s[order].copy()
        f_hz, rate = self.frequency_hz[order], self.rate_hz_s[order]
        kept = np.ones(len(order), dtype=bool)
        last = 0
        for k in range(1, len(order)):
            if station[k] == station[last]:
                gap_s = start[k].seconds_since(start[last])[0]
                if gap_s < duration_s[last] - _TOLERANCE_S:
                    # Where tables overlap both must say the same; a ramp that was cut is followed by the whole one.
                    end_hz = f_hz[last] + rate[last] * gap_s
                    same = abs(end_hz - f_hz[k]) < _TOLERANCE_HZ and abs(rate[k] - rate[last]) < 1e-9
                    if not same:
                        raise InputError(
                            f"ramps of {self.stations[station[k]]} contradict each other at "
                            f"{utc_strings(tai_to_utc(start[k]))[0]} UTC: {float(end_hz)!r} and {float(f_hz[k])!r} Hz; "
                            "leave one of the two tables out, or correct it"
                        )
                    duration_s[last] = max(duration_s[last], gap_s + duration_s[k])
                    kept[k] = False
                    continue
            last = k
        # Stations of which no piece has a length have no transmitted frequency.
        used, index = np.unique(station[kept], return_inverse=True)
        names = tuple(self.stations[k] for k in used)
        return Ramps(names, index.astype(np.int32), start[kept], duration_s[kept], f_hz[kept], rate[kept])

    def of_station(self, name: str) -> TransmittedFrequency:
        """The frequency of one of the stations."""
        rows = self.station == self.stations.index(name)
        return TransmittedFrequency(
            self.start[rows], self.duration_s[rows], self.frequency_hz[rows], self.rate_hz_s[rows]
        )


def _to_nanosecond(utc: Epochs) -> Epochs:
    """Epochs without the picoseconds that conversions leave; frequencies are set more roughly."""
    nothing = np.zeros(len(utc))
    begin, end = (utc_to_tai(Epochs(utc.jd + day, nothing, "UTC")) for day in (0, 1))
    per_day = 1e9 * np.round(end.seconds_since(begin))
    return Epochs(utc.jd, np.round(utc.fraction * per_day) / per_day, "UTC")


@dataclass(frozen=True, slots=True, eq=False)
class RampTerm:
    """What ramps do to the values of n light paths; the arrays are filled where there are ramps."""

    excess_m: Floats  # to be taken off the length
    scale: NDArray[
        np.float64
    ]  # of partials by what moves the transmission: transmitted over reference frequency
    by_tag_m_s: Floats  # what the time tag changes besides the length
    status: NDArray[np.int8]

    @classmethod
    def none(cls, n: int) -> RampTerm:
        """Of n paths without ramps."""
        return cls(np.zeros(n), np.ones(n), np.zeros(n), np.zeros(n, dtype=np.int8))


def ramp_term(
    frequencies: Mapping[str, TransmittedFrequency],
    sender: NDArray[np.str_],
    tag: Epochs,
    sent_s: Floats,
    other: NDArray[np.intp],
    reference_hz: Floats,
) -> RampTerm:
    """Compute the effect of the transmitted frequencies, by name of the sender (empty: none), on n light paths."""
    # `tag` is the time tag, or the end of a count (TT), `sent_s` the transmission by the sender's clock since then, and
    # `other` the path at the other end of a count, or -1.
    term = RampTerm.none(len(sender))
    term.status[sender != ""] = Status.NO_RAMP
    counted = other >= 0
    for name, frequency in frequencies.items():
        rows = np.flatnonzero(sender == name)
        origin = tai_to_tt(frequency.origin)
        tag_s = np.full(len(sender), np.nan)
        tag_s[rows] = tag[rows].seconds_since(origin)
        time_s = tag_s + sent_s
        end_s = np.where(counted, time_s[other], tag_s)
        rows = rows[frequency.covers(time_s[rows], end_s[rows])]
        term.status[rows] = Status.OK
        f0_hz, ranges = reference_hz[rows], ~counted[rows]
        # One instant for both ends of a count: the reference frequency's cycles are counted from there on.
        since_s = np.where(counted, np.minimum(tag_s, tag_s[other]), tag_s)[rows]
        sent_hz, cycles = frequency.at(time_s[rows], since_s, f0_hz)
        now_hz, until = frequency.at(tag_s[rows], since_s, f0_hz)
        term.scale[rows] = sent_hz / f0_hz
        term.by_tag_m_s[rows] = C_M_S / f0_hz * (np.where(ranges, now_hz, f0_hz) - sent_hz)
        term.excess_m[rows] = C_M_S / f0_hz * (cycles - np.where(ranges, until, 0.0))
    return term


class TransmittedFrequency:
    """The frequency of one station as a function of time: value and cycles."""

    def __init__(
        self,
        start: Epochs,
        duration_s: Floats,
        frequency_hz: Floats,
        rate_hz_s: Floats,
    ) -> None:
        self.origin = start[0]
        self._start_s = start.seconds_since(start[:1])
        self._duration_s, self._frequency_hz, self._rate_hz_s = duration_s, frequency_hz, rate_hz_s
        gap = np.diff(self._start_s) - duration_s[:-1] > _TOLERANCE_S
        gap |= np.abs(np.diff(frequency_hz)) > _MAX_STEP_FRACTION * frequency_hz[1:]
        # Within a block without gaps, cycles are counted beyond those of its first frequency: 1e15 would lose digits.
        self._block = np.concatenate([[0], np.cumsum(gap)])
        first = np.searchsorted(self._block, np.arange(self._block[-1] + 1))
        self._base_hz = frequency_hz[first][self._block]
        steps = np.diff(self._start_s, append=self._start_s[-1] + duration_s[-1])
        cycles = ((frequency_hz - self._base_hz) + 0.5 * rate_hz_s * steps) * steps
        self._cycles = np.concatenate([[0.0], np.cumsum(cycles)[:-1]])

    def covers(self, first_s: Floats, last_s: Floats) -> NDArray[np.bool_]:
        """Whether there are ramps without a gap between two times, s since :attr:`origin`, shape (n,)."""
        (one, inside_one), (other, inside_other) = self._find(first_s), self._find(last_s)
        return inside_one & inside_other & (self._block[one] == self._block[other])

    def at(self, time_s: Floats, since_s: Floats, reference_hz: Floats) -> tuple[Floats, Floats]:
        """Return frequency, Hz, and cycles beyond a reference frequency, at times in s since :attr:`origin`, (n,)."""
        # Cycles are counted from one instant for all times in a block without gaps, those of the reference frequency
        # from `since_s` on, so that only differences for the same `since_s` have a meaning.
        k, _ = self._find(time_s)
        within_s = time_s - self._start_s[k]
        over_hz = self._frequency_hz[k] - self._base_hz[k]
        cycles = self._cycles[k] + (over_hz + 0.5 * self._rate_hz_s[k] * within_s) * within_s
        cycles += (self._base_hz[k] - reference_hz) * (time_s - since_s)
        return self._frequency_hz[k] + self._rate_hz_s[k] * within_s, cycles

    def _find(self, time_s: Floats) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
        """The ramp at each time, and whether it is inside."""
        k = np.maximum(np.searchsorted(self._start_s, time_s, side="right") - 1, 0)
        within_s = time_s - self._start_s[k]
        return k, (within_s >= 0.0) & (within_s <= self._duration_s[k] + _TOLERANCE_S)


def turnaround_ratio(uplink: str, downlink: str) -> Fraction:
    """Return the ratio of the coherent downlink's frequency to the uplink's, of bands such as ``"X"`` and ``"Ka"``."""
    return Fraction(DOWNLINK[downlink], UPLINK[uplink])
