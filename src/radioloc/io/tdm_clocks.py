"""CLOCK_BIAS and CLOCK_DRIFT of a Tracking Data Message: how station clocks stand to UTC and to each other.

A record holds the reading of the clock of participant 2 less that of participant 1 (3.5.6.1); either may be
UTC itself (``UTC``, ``UTC-NIST``, ...). At a given time the last record before it counts, moved on by its drift
where it has one: nothing is known before the first.

Source: CCSDS 503.0-B-2 (2020), 3.5.6.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from radioloc.errors import FileFormatError
from radioloc.io.tdm_file import TdmFile, TdmSegment
from radioloc.io.tdm_paths import Names, participant
from radioloc.io.tdm_times import seconds_from
from radioloc.time import Epochs

UTC = "utc"


@dataclass(frozen=True, slots=True, eq=False)
class ClockDifference:
    """Clock of one participant less that of another, in steps and slopes.

    Parameters
    ----------
    origin : str
        File and line of its first record, for messages.
    start : Epochs
        Epoch of the first record, UTC.
    since_s : ndarray, shape (n,)
        Seconds from there to each record.
    bias_s, drift : ndarray, shape (n,)
        Difference at each record, s, and its rate, s/s.
    places : tuple of int
        Segments that it comes from.
    """

    origin: str
    start: Epochs
    since_s: NDArray[np.float64]
    bias_s: NDArray[np.float64]
    drift: NDArray[np.float64]
    places: tuple[int, ...]

    def at(self, utc: Epochs) -> NDArray[np.float64]:
        """Difference at epochs (UTC), s, shape (n,); NaN before the first record."""
        since = seconds_from(self.start, utc)
        row = np.searchsorted(self.since_s, since, side="right") - 1
        value = self.bias_s[row] + self.drift[row] * (since - self.since_s[row])
        return np.where(row < 0, np.nan, value)


@dataclass(frozen=True, slots=True)
class Clocks:
    """All differences of clocks that the messages give, by the two participants' keys."""

    differences: dict[tuple[str, str], ClockDifference]

    @classmethod
    def of(cls, segments: Sequence[tuple[TdmFile, TdmSegment]], names: Names) -> Clocks:
        """Collect the clock records of all segments.

        Raises
        ------
        FileFormatError
            There are not two participants, or a drift has no bias at its epoch.
        """
        found: dict[tuple[str, str], list[tuple[TdmFile, TdmSegment, int]]] = {}
        for place, (file, segment) in enumerate(segments):
            if not {"CLOCK_BIAS", "CLOCK_DRIFT"} & set(segment.keywords()):
                continue
            keys = []
            for number in (1, 2):
                if f"PARTICIPANT_{number}" not in segment.metadata:
                    problem = "CLOCK_BIAS is the difference of two clocks, but PARTICIPANT_{} is missing"
                    raise FileFormatError(file.path, problem.format(number), segment.line_of(""))
                name = participant(segment, number)
                keys.append(UTC if name.upper().startswith("UTC") else names.key(name))
            found.setdefault((keys[0], keys[1]), []).append((file, segment, place))
        return cls({pair: _difference(parts) for pair, parts in found.items()})

    def between(self, first: str, second: str) -> list[tuple[float, ClockDifference]]:
        """Clock of the second participant less that of the first, as a sum of signed known differences.

        Records of the two themselves count; where there are none, those of each to UTC. A clock of which nothing
        is said shows UTC (the standard's default). Empty where nothing is said of either.
        """
        if first == second:
            return []
        direct = self._signed(first, second)
        return (
            [direct]
            if direct
            else [part for part in (self._signed(first, UTC), self._signed(UTC, second)) if part]
        )

    def utc_minus(self, station: str) -> list[tuple[float, ClockDifference]]:
        """UTC less the clock of a station, as :meth:`between`."""
        part = self._signed(station, UTC)
        return [part] if part else []

    def _signed(self, first: str, second: str) -> tuple[float, ClockDifference] | None:
        for pair, sign in (((first, second), 1.0), ((second, first), -1.0)):
            if pair in self.differences:
                return sign, self.differences[pair]
        return None


def _difference(parts: Sequence[tuple[TdmFile, TdmSegment, int]]) -> ClockDifference:
    """Join the records of one pair, in order of time."""
    file, segment, _ = parts[0]
    start = segment.epoch[[0]]
    origin = f"{file.path}, line {segment.line[0]}"
    times, biases, drifts = [], [], []
    for file, segment, _ in parts:
        bias, drift = segment.rows("CLOCK_BIAS"), segment.rows("CLOCK_DRIFT")
        bias_s = seconds_from(start, segment.epoch[bias])
        drift_s = seconds_from(start, segment.epoch[drift])
        alone = ~np.isin(drift_s, bias_s)
        if alone.any():
            problem = "CLOCK_DRIFT has no CLOCK_BIAS at its epoch, from which it would run; add that"
            raise FileFormatError(file.path, problem, int(segment.line[drift[np.argmax(alone)]]))
        slope = np.zeros(len(bias))
        slope[np.searchsorted(bias_s, drift_s)] = segment.value[drift]
        times.append(bias_s)
        biases.append(segment.value[bias])
        drifts.append(slope)
    time = np.concatenate(times)
    order = np.argsort(time, kind="stable")
    return ClockDifference(
        origin,
        start,
        time[order],
        np.concatenate(biases)[order],
        np.concatenate(drifts)[order],
        tuple(place for _, _, place in parts),
    )
