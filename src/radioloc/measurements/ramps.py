"""Frequencies of deep-space links: ramps of the transmitted frequency, linear in pieces, and bands.

A coherent measurement counts cycles of the transmitted frequency f_T. In metres, by the reference frequency f_0 of the
observation, Doppler over the count interval T is c T less c / f_0 times the integral of f_T from t1 at its start to t1
at its end, and a range is c / f_0 times the integral from t1 to t3. Both are the length of the light path, or its
change, less c / f_0 times the integral of f_T - f_0 up to the transmission at t1, without a light time of the user.

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
from radioloc.measurements.table_columns import is_single_precision
from radioloc.media.medium import Status
from radioloc.quantities import accepts_quantities
from radioloc.time import Epochs, tai_to_tt, tai_to_utc, utc_strings, utc_to_tai
from radioloc.vectors import Floats, Indices, Mask

UPLINK = {"S": 221, "X": 749, "Ka": 3599}  # ratios of the uplink frequencies of a channel
DOWNLINK = {"S": 240, "X": 880, "Ka": 3344}  # coherent downlinks of the channel, on the scale of its uplinks
DOWNLINK_LIMITS_HZ = {"S": (2.20e9, 2.31e9), "X": (8.40e9, 8.50e9), "Ka": (31.8e9, 32.3e9)}

_TOLERANCE_S = 1e-6  # between contiguous ramps; frequencies are set to the microsecond
_TOLERANCE_HZ = 1e-3
_MAX_STEP_FRACTION = 0.01  # largest relative step of the frequency within a signal


@dataclass(frozen=True, slots=True, eq=False)
class Ramps:
    """Pieces of the transmitted frequency by the clock of the station, from :meth:`Ramps.from_columns`."""

    stations: tuple[str, ...]  #: names of the transmitting stations, each once
    station: NDArray[np.int32]  #: (n,), index into ``stations``
    start: Epochs  #: starts, TAI, n epochs
    duration_s: Floats  #: (n,), durations, s
    frequency_hz: Floats  #: (n,), transmitted frequency at the start, Hz, and its rate, Hz/s
    rate_hz_s: Floats  #: likewise

    @classmethod
    def empty(cls) -> Ramps:
        """Return a record without ramps."""
        zeros = np.zeros(0)
        return cls((), np.zeros(0, np.int32), Epochs(zeros, zeros, "TAI"), zeros, zeros, zeros)

    @classmethod
    @accepts_quantities
    def from_columns(
        cls, station: Sequence[str], start: Epochs, stop: Epochs, frequency_hz: Floats, rate_hz_s: Floats
    ) -> Ramps:
        """Check ramps of stations and sort them; duplicates are merged.

        Parameters
        ----------
        station : sequence of str
            Name of the transmitting station of each ramp.
        start, stop : Epochs
            UTC by the clock of the station, n epochs.
        frequency_hz, rate_hz_s : array_like, shape (n,)
            Frequency at the start, Hz, and its rate, Hz/s.

        Raises
        ------
        InputError
            A ramp ends before its start, is outside of 1e6 to 1e12 Hz, or contradicts another ramp.
        """
        start.require("UTC")
        stop.require("UTC")
        if is_single_precision(frequency_hz):
            raise InputError(
                "frequency_hz: expected double precision, got float32, which rounds to hundreds of Hz"
            )
        start_tai, names = utc_to_tai(start), tuple(dict.fromkeys(station))
        code = np.array([names.index(name) for name in station], dtype=np.int32)
        duration_s = utc_to_tai(stop).seconds_since(start_tai)
        f_hz, rate = np.asarray(frequency_hz, dtype=np.float64), np.asarray(rate_hz_s, dtype=np.float64)
        wrong = ~((duration_s >= 0.0) & (f_hz > 1e6) & (f_hz < 1e12) & np.isfinite(rate))
        if wrong.any():
            k = int(np.argmax(wrong))
            raise InputError(
                f"ramp of {station[k]} at {utc_strings(start[k])[0]}: expected 1e6 to 1e12 Hz, and an end after the "
                f"start, got {f_hz[k]!r} Hz, {rate[k]!r} Hz/s over {duration_s[k]:g} s"
            )
        return cls(names, code, start_tai, duration_s, f_hz, rate)._in_order()

    def __len__(self) -> int:
        return len(self.duration_s)

    def __repr__(self) -> str:
        return f"<Ramps {len(self)} of {len(self.stations)} stations>"

    @property
    def start_utc(self) -> Epochs:
        """Starts in UTC."""
        return _to_nanosecond(tai_to_utc(self.start))

    @property
    def stop_utc(self) -> Epochs:
        """Ends in UTC."""
        return _to_nanosecond(tai_to_utc(self.start.shifted(self.duration_s)))

    @staticmethod
    def concatenate(parts: Sequence[Ramps]) -> Ramps:
        """Join ramps; raise an InputError if two contradict each other."""
        parts = [part for part in parts if len(part)]
        if len({id(part) for part in parts}) <= 1:
            return parts[0] if parts else Ramps.empty()
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
        """Return ramps sorted by station and time, without overlaps."""
        order = np.lexsort((self.start.fraction, self.start.jd, self.station))
        order = order[self.duration_s[order] > _TOLERANCE_S]
        start, station, duration_s = self.start[order], self.station[order], self.duration_s[order].copy()
        f_hz, rate = self.frequency_hz[order], self.rate_hz_s[order]
        is_kept = np.ones(len(order), dtype=bool)
        last = 0
        for k in range(1, len(order)):
            if station[k] == station[last]:
                gap_s = start[k].seconds_since(start[last])[0]
                if gap_s < duration_s[last] - _TOLERANCE_S:
                    # Overlapping tables must agree; the complete copy of a truncated ramp extends it.
                    end_hz = f_hz[last] + rate[last] * gap_s
                    if not (abs(end_hz - f_hz[k]) < _TOLERANCE_HZ and abs(rate[k] - rate[last]) < 1e-9):
                        raise InputError(
                            f"ramps of {self.stations[station[k]]} contradict each other at "
                            f"{utc_strings(tai_to_utc(start[k]))[0]} UTC: {float(end_hz)!r} and {float(f_hz[k])!r} Hz; "
                            "remove or correct one of the tables"
                        )
                    duration_s[last] = max(duration_s[last], gap_s + duration_s[k])
                    is_kept[k] = False
                    continue
            last = k
        # Stations with ramps of zero length only are dropped.
        used, index = np.unique(station[is_kept], return_inverse=True)
        names = tuple(self.stations[k] for k in used)
        return Ramps(
            names, index.astype(np.int32), start[is_kept], duration_s[is_kept], f_hz[is_kept], rate[is_kept]
        )

    def of_station(self, name: str) -> TransmittedFrequency:
        """Return the transmitted frequency of a station."""
        rows = self.station == self.stations.index(name)
        return TransmittedFrequency(
            self.start[rows], self.duration_s[rows], self.frequency_hz[rows], self.rate_hz_s[rows]
        )


def _to_nanosecond(utc: Epochs) -> Epochs:
    """Return epochs rounded to nanoseconds, without the rounding errors of conversions."""
    zeros = np.zeros(len(utc))
    first, last = (utc_to_tai(Epochs(utc.jd + day, zeros, "UTC")) for day in (0, 1))
    per_day = 1e9 * np.round(last.seconds_since(first))
    return Epochs(utc.jd, np.round(utc.fraction * per_day) / per_day, "UTC")


@dataclass(frozen=True, slots=True, eq=False)
class RampTerm:
    """Effect of ramps on the values of n light paths; neutral for paths without ramps."""

    excess_m: Floats  # to be subtracted from the length
    scale: Floats  # of partials of the length: transmitted over reference frequency
    by_tag_m_s: Floats  # partial by the time tag beside that of the length
    status: NDArray[np.int8]

    @classmethod
    def zeros(cls, n: int) -> RampTerm:
        """Return the neutral term of n paths."""
        return cls(np.zeros(n), np.ones(n), np.zeros(n), np.zeros(n, dtype=np.int8))


def ramp_term(
    frequencies: Mapping[str, TransmittedFrequency],
    sender: NDArray[np.str_],
    tag: Epochs,
    sent_s: Floats,
    partner: Indices,
    reference_hz: Floats,
) -> RampTerm:
    """Return the effect of transmitted frequencies, by name of the sender (empty without ramps), on n light paths."""
    # `tag` is the time tag, or the end of a count (TT), `sent_s` the transmission by the sender's clock since then, and
    # `partner` the path at the opposite end of a count, or -1.
    term = RampTerm.zeros(len(sender))
    term.status[sender != ""] = Status.NO_RAMP
    counted = partner >= 0
    for name, frequency in frequencies.items():
        rows = np.flatnonzero(sender == name)
        origin = tai_to_tt(frequency.origin)
        tag_s = np.full(len(sender), np.nan)
        tag_s[rows] = tag[rows].seconds_since(origin)
        time_s = tag_s + sent_s
        end_s = np.where(counted, time_s[partner], tag_s)
        rows = rows[frequency.covers(time_s[rows], end_s[rows])]
        term.status[rows] = Status.OK
        f0_hz, ranges = reference_hz[rows], ~counted[rows]
        # Cycles of the reference frequency are counted from an instant common to both ends of a count.
        since_s = np.where(counted, np.minimum(tag_s, tag_s[partner]), tag_s)[rows]
        sent_hz, cycles = frequency.frequency_and_cycles(time_s[rows], since_s, f0_hz)
        tag_hz, cycles_to_tag = frequency.frequency_and_cycles(tag_s[rows], since_s, f0_hz)
        term.scale[rows] = sent_hz / f0_hz
        term.by_tag_m_s[rows] = C_M_S / f0_hz * (np.where(ranges, tag_hz, f0_hz) - sent_hz)
        term.excess_m[rows] = C_M_S / f0_hz * (cycles - np.where(ranges, cycles_to_tag, 0.0))
    return term


class TransmittedFrequency:
    """Transmitted frequency of a station as a function of time."""

    def __init__(self, start: Epochs, duration_s: Floats, frequency_hz: Floats, rate_hz_s: Floats) -> None:
        self.origin = start[0]
        self._start_s = start.seconds_since(start[:1])
        self._duration_s, self._frequency_hz, self._rate_hz_s = duration_s, frequency_hz, rate_hz_s
        gap = np.diff(self._start_s) - duration_s[:-1] > _TOLERANCE_S
        gap |= np.abs(np.diff(frequency_hz)) > _MAX_STEP_FRACTION * frequency_hz[1:]
        # In a block without gaps, cycles are relative to its first frequency; totals of 1e15 would lose digits.
        self._block = np.concatenate([[0], np.cumsum(gap)])
        first = np.searchsorted(self._block, np.arange(self._block[-1] + 1))
        self._base_hz = frequency_hz[first][self._block]
        steps = np.diff(self._start_s, append=self._start_s[-1] + duration_s[-1])
        cycles = ((frequency_hz - self._base_hz) + 0.5 * rate_hz_s * steps) * steps
        self._cycles = np.concatenate([[0.0], np.cumsum(cycles)[:-1]])

    def covers(self, first_s: Floats, last_s: Floats) -> Mask:
        """Return whether ramps cover the time between two instants without gap, s since :attr:`origin`, shape (n,)."""
        (first, is_first_in), (last, is_last_in) = self._find(first_s), self._find(last_s)
        return is_first_in & is_last_in & (self._block[first] == self._block[last])

    def frequency_and_cycles(
        self, time_s: Floats, since_s: Floats, reference_hz: Floats
    ) -> tuple[Floats, Floats]:
        """Return frequency, Hz, and cycles beyond a reference frequency, at times in s since :attr:`origin`, (n,)."""
        # Only differences of cycles in a block without gaps, with the same `since_s`, are meaningful.
        k, _ = self._find(time_s)
        within_s = time_s - self._start_s[k]
        offset_hz = self._frequency_hz[k] - self._base_hz[k]
        cycles = self._cycles[k] + (offset_hz + 0.5 * self._rate_hz_s[k] * within_s) * within_s
        cycles += (self._base_hz[k] - reference_hz) * (time_s - since_s)
        return self._frequency_hz[k] + self._rate_hz_s[k] * within_s, cycles

    def _find(self, time_s: Floats) -> tuple[Indices, Mask]:
        """Return the ramp at each time, and whether the time is in it."""
        k = np.maximum(np.searchsorted(self._start_s, time_s, side="right") - 1, 0)
        within_s = time_s - self._start_s[k]
        return k, (within_s >= 0.0) & (within_s <= self._duration_s[k] + _TOLERANCE_S)


def turnaround_ratio(uplink: str, downlink: str) -> Fraction:
    """Return the ratio of the coherent downlink's frequency to the uplink's, of bands such as ``"X"`` and ``"Ka"``."""
    return Fraction(DOWNLINK[downlink], UPLINK[uplink])
