"""What the segments of Tracking Data Messages say beside their measurements: transmitted frequencies, clocks, weather.

A frequency TRANSMIT_FREQ_n is that from its epoch on, and TRANSMIT_FREQ_RATE_n its rate from then until the next record
of a rate (3.5.2.9, 3.5.2.10). A record CLOCK_BIAS holds the reading of the clock of participant 2 less that of
participant 1 (3.5.6.1); either may be UTC itself (``UTC``, ``UTC-NIST``, ...). It counts from its epoch until the next,
moved on by a CLOCK_DRIFT of the same epoch. Before the first record nothing is known.

TEMPERATURE (K), PRESSURE (hPa) and RHUMIDITY are interpolated linearly between the records, and held before the first
and after the last; where the nearest record is more than two hours away the weather counts as not recorded, as in laser
ranging files.

Source: CCSDS 503.0-B-2 (2020), section 3.5.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radioloc.errors import FileFormatError, StationError
from radioloc.io.checks import Catalogue, weather_near
from radioloc.io.tdm.message import CLOCKS, MEASURED, SENT, SENT_RATE, WEATHER, TdmFile, TdmSegment
from radioloc.measurements.targets import canonical_target
from radioloc.time import Epochs, tai_to_utc, utc_to_tai

_UTC = "utc"


def shifted_utc(utc: Epochs, shift_s: ArrayLike) -> Epochs:
    """Epochs moved later by SI seconds, over leap seconds where need be; those not moved keep their last bit."""
    shift = np.broadcast_to(np.asarray(shift_s, dtype=np.float64), (len(utc),))
    moved = np.flatnonzero(shift)
    if len(moved) == 0:
        return utc
    new = tai_to_utc(utc_to_tai(utc[moved]).shifted(shift[moved]))
    jd, fraction = utc.jd.copy(), utc.fraction.copy()
    jd[moved], fraction[moved] = new.jd, new.fraction
    return Epochs(jd, fraction, "UTC")


def seconds_from(start: Epochs, utc: Epochs) -> NDArray[np.float64]:
    """SI seconds from one epoch to others, all UTC, shape (n,)."""
    return utc_to_tai(utc).seconds_since(utc_to_tai(start)) if len(utc) else np.empty(0)


class Placed(NamedTuple):
    """A segment, the file it is of and its number among all segments of all files."""

    file: TdmFile
    segment: TdmSegment
    place: int

    def participant(self, number: int) -> str:
        """Name of a participant as the file gives it."""
        return self.segment.metadata[f"PARTICIPANT_{number}"]

    def path(self, keyword: str = "PATH") -> list[int]:
        """Participants of a path, in order; empty where the segment has no such path."""
        return [int(number) for number in self.segment.metadata.get(keyword, "").split(",") if number]

    def fail(self, keyword: str, problem: str, row: int = 0) -> FileFormatError:
        """Error at one of the records of a data keyword, or at the line of a metadata keyword."""
        return FileFormatError(self.file.path, problem, self.segment.line_of(keyword, row))


@dataclass(frozen=True, slots=True)
class Names:
    """Names of participants as the catalogue writes them; without one they stay as they are."""

    catalogue: Catalogue | None

    def station(self, placed: Placed, number: int) -> str:
        """Name of a participant that must be a station; :class:`FileFormatError` if the catalogue does not know it."""
        name = placed.participant(number)
        if self.catalogue is None:
            return name
        try:
            return str(self.catalogue.get(name).name)
        except StationError as error:
            keyword = f"PARTICIPANT_{number}"
            raise placed.fail(keyword, f"{keyword}: {error}") from None

    def key(self, name: str) -> str:
        """Text by which the same participant is known again in another segment.

        Case does not matter, and an underscore is a blank (4.3.7, 4.3.8).
        """
        if self.catalogue is not None:
            try:
                return str(self.catalogue.get(name).name).casefold()
            except StationError:
                pass
        return " ".join(canonical_target(name).replace("_", " ").split())


class SeriesPart(NamedTuple):
    """Records of one segment: keywords of a quantity and of its rate; what to add to their epochs and values."""

    placed: Placed
    keyword: str
    rate_keyword: str
    delay_s: float = 0.0
    correction: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Series:
    """A quantity that is given at some epochs, each time with the rate at which it changes until the next.

    ``origin`` is file and line of the first record, ``start`` its epoch (UTC), from which the records are ``since_s``
    seconds; ``places`` are the segments that they come from.
    """

    origin: str
    start: Epochs
    since_s: NDArray[np.float64]
    value: NDArray[np.float64]
    rate: NDArray[np.float64]
    places: tuple[int, ...]

    @classmethod
    def of(cls, parts: Sequence[SeriesPart], *, rates_last: bool) -> Series:
        """Join records in order of time; a rate lasts until the next rate, or (False) until the next record."""
        file, segment, _ = parts[0].placed
        start = segment.epoch[[0]]
        times, values, rate_times, rates = [], [], [], []
        for (_, segment, _), keyword, rate_keyword, delay_s, correction in parts:
            rows, rate_rows = segment.rows(keyword), segment.rows(rate_keyword)
            times.append(seconds_from(start, segment.epoch[rows]) + delay_s)
            values.append(segment.value[rows] + correction)
            rate_times.append(seconds_from(start, segment.epoch[rate_rows]) + delay_s)
            rates.append(segment.value[rate_rows])
        time = np.concatenate(times)
        for part, mine in zip(parts, rate_times, strict=True):
            alone = ~np.isin(mine, time)
            if alone.any():
                problem = f"{part.rate_keyword} has no {part.keyword} at its epoch, from which it would run; add that"
                raise part.placed.fail(part.rate_keyword, problem, int(np.argmax(alone)))
        order, rate_time = np.argsort(time, kind="stable"), np.concatenate(rate_times)
        time, rate_order = time[order], np.argsort(rate_time, kind="stable")
        steps = np.concatenate([[0.0], np.concatenate(rates)[rate_order]])
        rate = steps[np.searchsorted(rate_time[rate_order], time, side="right")]
        if not rates_last:
            rate = np.where(np.isin(time, rate_time), rate, 0.0)
        origin = f"{file.path}, line {parts[0].placed.segment.line[0]}"
        places = tuple(part.placed.place for part in parts)
        return cls(origin, start, time, np.concatenate(values)[order], rate, places)

    @property
    def constant(self) -> bool:
        """Whether there is but one value."""
        return bool((self.value == self.value[0]).all() and not self.rate.any())

    def at(self, utc: Epochs) -> NDArray[np.float64]:
        """The quantity at epochs (UTC), shape (n,); NaN before the first record."""
        since = seconds_from(self.start, utc)
        row = self._row(since)
        value = self.value[row] + self.rate[row] * (since - self.since_s[row])
        return np.where(row < 0, np.nan, value)

    def excess(self, since: NDArray[np.float64], until: NDArray[np.float64]) -> NDArray[np.float64]:
        """Integral between two times (s from ``start``) of the quantity less its first value; NaN before that."""
        above = self.value - self.value[0]
        step = np.diff(self.since_s)
        whole = above[:-1] * step + 0.5 * self.rate[:-1] * step**2
        before = np.concatenate([[0.0], np.cumsum(whole)])

        def integral(time: NDArray[np.float64]) -> NDArray[np.float64]:
            row = self._row(time)
            passed = time - self.since_s[row]
            value = before[row] + (above[row] + 0.5 * self.rate[row] * passed) * passed
            return np.where(row < 0, np.nan, value)

        return integral(until) - integral(since)

    def _row(self, since: NDArray[np.float64]) -> NDArray[np.intp]:
        return np.searchsorted(self.since_s, since, side="right") - 1


Sent = Mapping[tuple[str, str], Sequence[tuple[Placed, int]]]
"""Segments and participants of which sent frequencies are given, by the keys of sender and first receiver."""


def sent_frequencies(segments: Iterable[Placed], names: Names) -> Sent:
    """All frequencies that the messages say were sent."""
    found: dict[tuple[str, str], list[tuple[Placed, int]]] = {}
    for placed in segments:
        held, path = placed.segment.counts(), placed.path()
        for n, keywords in enumerate(zip(SENT, SENT_RATE, strict=True), start=1):
            there = [keyword for keyword in keywords if keyword in held]
            if not there or placed.segment.metadata.get("MODE") == "SINGLE_DIFF":
                continue
            if n not in path[:-1]:
                problem = f"is there, but on its PATH participant {n} sends nothing; correct one"
                raise placed.fail(there[0], f"{keywords[0]} {problem}")
            ends = (n, path[path.index(n) + 1])
            sender, to = (names.key(placed.participant(number)) for number in ends)
            found.setdefault((sender, to), []).append((placed, n))
    return found


def frequency_sent(
    sent: Sent, pair: tuple[str, str], place: int, n: int, band: str, *, needed: bool, delays_removed: bool
) -> Series | None:
    """Frequency sent by participant n of a segment to another: of the segment itself, else of others of its band.

    Others are segments that hold no measurement: a frequency that stands beside measurements is that of these.
    Where the frequency is needed and there is none such, it is looked for there too.
    """
    parts = sent.get(pair, [])
    own = [part for part in parts if (part[0].place, part[1]) == (place, n)]
    if not own:
        alone = [part for part in parts if not set(MEASURED) & set(part[0].segment.counts())]
        parts = parts if needed and not alone else alone
        bands = [placed.segment.metadata.get("TRANSMIT_BAND", "").upper() for placed, _ in parts]
        if band:
            chosen = band.upper() if band.upper() in bands else ""
            parts = [part for part, other in zip(parts, bands, strict=True) if other == chosen]
        elif len(set(bands)) > 1:
            several = f"is given in several bands ({', '.join(sorted(filter(None, set(bands))))})"
            problem = f"{SENT[n - 1]} {several}; say TRANSMIT_BAND where it is used"
            raise parts[0][0].fail("TRANSMIT_BAND", problem)
    joined = []
    for placed, number in own or parts:
        segment, keyword = placed.segment, SENT[number - 1]
        correction_hz = segment.correction("TRANSMIT")
        wrong = ~(segment.value[segment.rows(keyword)] + correction_hz > 0.0)
        if wrong.any():
            raise placed.fail(keyword, f"{keyword} must be above zero", int(np.argmax(wrong)))
        # Epochs are those of the transmitter's electronics; the signal leaves the antenna later.
        delay_s = 0.0 if delays_removed else segment.number(f"TRANSMIT_DELAY_{number}")
        joined.append(SeriesPart(placed, keyword, SENT_RATE[number - 1], delay_s, correction_hz))
    return Series.of(joined, rates_last=True) if joined else None


def clocks_of(segments: Iterable[Placed], names: Names) -> dict[tuple[str, str], Series]:
    """Clock of the second participant less that of the first, s, by the keys of both."""
    found: dict[tuple[str, str], list[SeriesPart]] = {}
    for placed in segments:
        if not set(CLOCKS) & set(placed.segment.counts()):
            continue
        keys = []
        for number in (1, 2):
            if f"PARTICIPANT_{number}" not in placed.segment.metadata:
                problem = f"CLOCK_BIAS is the difference of two clocks, but PARTICIPANT_{number} is missing"
                raise placed.fail("", problem)
            name = placed.participant(number)
            keys.append(_UTC if name.upper().startswith("UTC") else names.key(name))
        found.setdefault((keys[0], keys[1]), []).append(SeriesPart(placed, *CLOCKS))
    return {pair: Series.of(parts, rates_last=False) for pair, parts in found.items()}


def clock_difference(
    clocks: Mapping[tuple[str, str], Series], first: str, second: str = _UTC
) -> list[tuple[float, Series]]:
    """Clock of the second participant (of UTC) less that of the first, as a sum of signed known differences.

    Records of the two themselves count; where there are none, those of each to UTC. A clock of which nothing is said
    shows UTC (the standard's default). Empty where nothing is said of either.
    """

    def signed(one: str, other: str) -> list[tuple[float, Series]]:
        there = [(sign, pair) for sign, pair in ((1.0, (one, other)), (-1.0, (other, one))) if pair in clocks]
        return [(sign, clocks[pair]) for sign, pair in there[:1]]

    if first == second:
        return []
    return signed(first, second) or signed(first, _UTC) + signed(_UTC, second)


def weather_at(segments: Sequence[TdmSegment], utc: Epochs) -> dict[str, NDArray[np.float64]]:
    """Weather columns at epochs (UTC), from segments that belong to them; NaN where none was recorded nearby."""
    out = {}
    for keyword, column in WEATHER.items():
        parts = [(segment, rows) for segment in segments if len(rows := segment.rows(keyword))]
        if not parts:
            continue
        start = parts[0][0].epoch[[0]]
        times = np.concatenate([seconds_from(start, segment.epoch[rows]) for segment, rows in parts])
        values = np.concatenate([segment.value[rows] for segment, rows in parts])
        order = np.argsort(times, kind="stable")
        out[column] = weather_near(times[order], values[order], seconds_from(start, utc))
    return out
