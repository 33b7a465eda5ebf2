"""Frequencies of a Tracking Data Message: what was sent, and Doppler from what was received.

A record TRANSMIT_FREQ_n is the frequency from its epoch on; TRANSMIT_FREQ_RATE_n is the rate at which it changes
from then until the next record of a rate (3.5.2.9, 3.5.2.10). RECEIVE_FREQ is the mean over the count interval.

With light time tau(t) at reception t, the phase that arrives at t left the transmitter at t - tau(t), multiplied by
the transponder's ratio M. The mean received frequency F over the count interval T from t0 on then obeys
(Moyer 2003, section 13.3)

    F T = M [phase(t0 + T - tau(t0 + T)) - phase(t0 - tau(t0))],

and what is wanted is the growth of the light time D = tau(t0 + T) - tau(t0). With a constant uplink f this gives
D = T (1 - F / (M f)) exactly, whatever the light time. With one that changes, the light time decides which part of the
ramp was received; it must be known beforehand, but coarsely: an error e in it makes one of T e f'/f in D (a ramp of
1 Hz/s at 7 GHz, 10 microseconds and 60 s: 0.03 mm).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from radioloc.constants import C_M_S
from radioloc.errors import FileFormatError
from radioloc.io.tdm_file import TdmFile, TdmSegment
from radioloc.io.tdm_keywords import MEASURED, SENT, SENT_RATE
from radioloc.io.tdm_paths import Names, numbers, participant
from radioloc.io.tdm_times import seconds_from
from radioloc.time import Epochs

# The uplink differs from its first frequency by 1e-5 of it at most: each round gains five digits of 16.
_ROUNDS = 4
_FASTEST_M_S = 3e5


@dataclass(frozen=True, slots=True, eq=False)
class SentFrequency:
    """Frequency that one participant sent to another, in steps and slopes.

    Parameters
    ----------
    start : Epochs
        Epoch of the first record, UTC.
    since_s : ndarray, shape (n,)
        Seconds from there to each record.
    frequency_hz, rate_hz_s : ndarray, shape (n,)
        Frequency at each record, and its rate until the next.
    places : tuple of int
        Segments that it comes from.
    """

    start: Epochs
    since_s: NDArray[np.float64]
    frequency_hz: NDArray[np.float64]
    rate_hz_s: NDArray[np.float64]
    places: tuple[int, ...]

    @property
    def constant(self) -> bool:
        """Whether there is but one frequency; it then holds at all times."""
        return bool((self.frequency_hz == self.frequency_hz[0]).all() and not self.rate_hz_s.any())

    def at(self, utc: Epochs) -> NDArray[np.float64]:
        """Frequency at epochs (UTC), Hz, shape (n,); NaN before the first record of one that changes."""
        if self.constant:
            return np.full(len(utc), self.frequency_hz[0])
        since = seconds_from(self.start, utc)
        row = self._row(since)
        frequency = self.frequency_hz[row] + self.rate_hz_s[row] * (since - self.since_s[row])
        return np.where(row < 0, np.nan, frequency)

    def excess_cycles(self, since: NDArray[np.float64], until: NDArray[np.float64]) -> NDArray[np.float64]:
        """Cycles sent between two times (s from ``start``) beyond those of the first frequency; NaN before it."""
        excess_hz = self.frequency_hz - self.frequency_hz[0]
        step = np.diff(self.since_s)
        whole = excess_hz[:-1] * step + 0.5 * self.rate_hz_s[:-1] * step**2
        before = np.concatenate([[0.0], np.cumsum(whole)])

        def cycles(time: NDArray[np.float64]) -> NDArray[np.float64]:
            row = self._row(time)
            passed = time - self.since_s[row]
            return np.where(
                row < 0, np.nan, before[row] + (excess_hz[row] + 0.5 * self.rate_hz_s[row] * passed) * passed
            )

        return cycles(until) - cycles(since)

    def _row(self, since: NDArray[np.float64]) -> NDArray[np.intp]:
        return np.searchsorted(self.since_s, since, side="right") - 1


_Part = tuple[TdmFile, TdmSegment, int, int]


@dataclass(frozen=True, slots=True)
class Sent:
    """All frequencies that the messages say were sent: where they stand, by the keys of sender and first receiver."""

    parts: dict[tuple[str, str], list[_Part]]
    delays_removed: bool

    @classmethod
    def of(
        cls, segments: Sequence[tuple[TdmFile, TdmSegment]], names: Names, *, delays_removed: bool
    ) -> Sent:
        """Find the transmitted frequencies of all segments, tagged at the antenna or (False) at the electronics.

        Raises
        ------
        FileFormatError
            Nobody is said to receive.
        """
        found: dict[tuple[str, str], list[_Part]] = {}
        for place, (file, segment) in enumerate(segments):
            held = set(segment.keywords())
            for n, (frequency, rate) in enumerate(zip(SENT, SENT_RATE, strict=True), start=1):
                path = numbers(segment)
                if not {frequency, rate} & held or segment.metadata.get("MODE") == "SINGLE_DIFF":
                    continue
                if n not in path[:-1]:
                    row = segment.rows(frequency if frequency in held else rate)[0]
                    problem = (
                        f"{frequency} is there, but on its PATH participant {n} sends nothing; correct one"
                    )
                    raise FileFormatError(file.path, problem, int(segment.line[row]))
                sender, to = participant(segment, n), participant(segment, path[path.index(n) + 1])
                found.setdefault((names.key(sender), names.key(to)), []).append((file, segment, n, place))
        return cls(found, delays_removed)

    def find(
        self, pair: tuple[str, str], band: str, place: int, n: int, *, needed: bool
    ) -> SentFrequency | None:
        """Frequency sent from one to another: of the segment itself, else of others of its band.

        Others are segments that hold no measurement: a frequency that stands beside measurements is that of these.
        Where the frequency is needed and there is none such, it is looked for there too.

        Parameters
        ----------
        pair : tuple of str
            Keys of sender and receiver.
        band : str
            TRANSMIT_BAND of the segment; empty where it does not say.
        place, n : int
            The segment, and the number of the participant in it.
        needed : bool
            Whether the measurement cannot be made use of without.

        Raises
        ------
        FileFormatError
            A frequency is not above zero, a rate has no frequency at its epoch, or the frequencies are of several
            bands and the segment does not say which is its own.
        """
        parts = self.parts.get(pair, [])
        own = [part for part in parts if part[2:] == (n, place)]
        if own:
            return self._joined(own)
        alone = [part for part in parts if not set(part[1].keywords()) & set(MEASURED)]
        parts = parts if needed and not alone else alone
        bands = [part[1].metadata.get("TRANSMIT_BAND", "").upper() for part in parts]
        if band:
            chosen = band.upper() if band.upper() in bands else ""
            parts = [part for part, other in zip(parts, bands, strict=True) if other == chosen]
        elif len(set(bands)) > 1:
            file, segment = parts[0][:2]
            problem = (
                f"{SENT[n - 1]} is given in several bands ({', '.join(sorted(filter(None, set(bands))))})"
            )
            problem += "; say TRANSMIT_BAND where it is used"
            raise FileFormatError(file.path, problem, segment.line_of("TRANSMIT_BAND"))
        return self._joined(parts) if parts else None

    def _joined(self, parts: Sequence[_Part]) -> SentFrequency:
        start = parts[0][1].epoch[[0]]
        times, frequencies, rate_times, rates = [], [], [], []
        for file, segment, n, _ in parts:
            rows, rate_rows = segment.rows(SENT[n - 1]), segment.rows(SENT_RATE[n - 1])
            applied = segment.metadata.get("CORRECTIONS_APPLIED") != "NO"
            frequency = segment.value[rows] + (0.0 if applied else segment.number("CORRECTION_TRANSMIT"))
            if not (frequency > 0.0).all():
                line = int(segment.line[rows[np.argmin(frequency)]])
                raise FileFormatError(file.path, f"{SENT[n - 1]} must be above zero", line)
            # Epochs are those of the transmitter's electronics; the signal leaves the antenna later.
            delay_s = 0.0 if self.delays_removed else segment.number(f"TRANSMIT_DELAY_{n}")
            times.append(seconds_from(start, segment.epoch[rows]) + delay_s)
            frequencies.append(frequency)
            rate_times.append(seconds_from(start, segment.epoch[rate_rows]) + delay_s)
            rates.append(segment.value[rate_rows])
        time, rate_time = np.concatenate(times), np.concatenate(rate_times)
        if len(time) == 0:
            file, segment, n, _ = parts[0]
            problem = f"{SENT_RATE[n - 1]} without any {SENT[n - 1]}, from which it would run; add that"
            raise FileFormatError(file.path, problem, int(segment.line[segment.rows(SENT_RATE[n - 1])[0]]))
        for (file, segment, n, _), part in zip(parts, rate_times, strict=True):
            alone = ~np.isin(part, time)
            if alone.any():
                line = int(segment.line[segment.rows(SENT_RATE[n - 1])[np.argmax(alone)]])
                problem = (
                    f"{SENT_RATE[n - 1]} has no {SENT[n - 1]} at its epoch, from which it would run; add that"
                )
                raise FileFormatError(file.path, problem, line)
        order, rate_order = np.argsort(time, kind="stable"), np.argsort(rate_time, kind="stable")
        time = time[order]
        steps = np.concatenate([[0.0], np.concatenate(rates)[rate_order]])
        rate = steps[np.searchsorted(rate_time[rate_order], time, side="right")]
        places = tuple(place for *_, place in parts)
        return SentFrequency(start, time, np.concatenate(frequencies)[order], rate, places)


@dataclass(frozen=True, slots=True, eq=False)
class Received:
    """Mean received frequencies of one link.

    Parameters
    ----------
    path : str
        The file, for messages.
    line : ndarray of int32, shape (n,)
        Lines in it.
    middle : Epochs
        Middles of the count intervals, UTC, at the station's reference point.
    count_s : float
        Count interval, s.
    offset_hz : float
        FREQ_OFFSET, to be added to the values, Hz.
    value_hz : ndarray, shape (n,)
        Values, Hz.
    """

    path: str
    line: NDArray[np.int32]
    middle: Epochs
    count_s: float
    offset_hz: float
    value_hz: NDArray[np.float64]

    def growth_m(
        self,
        sent: SentFrequency,
        turnaround: tuple[int, int],
        light_time_s: NDArray[np.float64] | None,
    ) -> NDArray[np.float64]:
        """Growth of the light path over the count interval, m, shape (n,).

        Parameters
        ----------
        sent : SentFrequency
            What was sent up.
        turnaround : tuple of int
            Numerator and denominator of the transponder's ratio.
        light_time_s : ndarray, shape (n,), or None
            Light time at the middle of each interval known beforehand, s.

        Raises
        ------
        FileFormatError
            The uplink changes and no light time was given, or it is not known when the signal left; or the result
            is faster than anything that is tracked.
        """
        up, down = turnaround
        base_hz = float(sent.frequency_hz[0])
        # Differences of nearly equal frequencies first: the digits that cancel are then gone without loss.
        slower = ((up * base_hz - down * self.offset_hz) - down * self.value_hz) / (up * base_hz)
        growth_s = self.count_s * slower
        if not sent.constant:
            if light_time_s is None:
                problem = "the transmitted frequency changes: which part of it was received depends on the light time"
                raise FileFormatError(
                    self.path, f"{problem}; give light_time_s, to some microseconds", int(self.line[0])
                )
            middle = seconds_from(sent.start, self.middle)
            ramped_s = growth_s
            for _ in range(_ROUNDS):
                left = middle - 0.5 * self.count_s - (light_time_s - 0.5 * growth_s)
                cycles = sent.excess_cycles(left, left + self.count_s - growth_s)
                growth_s = ramped_s + cycles / base_hz
            if np.isnan(growth_s).any():
                row = int(np.argmax(np.isnan(growth_s)))
                problem = "was sent before the first TRANSMIT_FREQ; add earlier ones or leave the record out"
                raise FileFormatError(self.path, f"what was received {problem}", int(self.line[row]))
        growth_m = C_M_S * growth_s
        fast = np.abs(growth_m) > _FASTEST_M_S * self.count_s
        if fast.any():
            row = int(np.argmax(fast))
            speed = growth_m[row] / self.count_s
            problem = (
                f"the received frequency makes the path grow by {speed:.6g} m/s, with a turnaround of {up}/{down} and "
                f"{base_hz!r} Hz sent; correct the ratio, the offset or the frequency"
            )
            raise FileFormatError(self.path, problem, int(self.line[row]))
        return growth_m
