"""What segments of messages say for each other: names, transmitted frequencies, differences of clocks.

A frequency TRANSMIT_FREQ_n is that from its epoch on, and TRANSMIT_FREQ_RATE_n its rate from then until the next record
of a rate (3.5.2.9, 3.5.2.10). A record CLOCK_BIAS holds the reading of the clock of participant 2 less that of
participant 1 (3.5.6.1); either may be UTC itself (``UTC``, ``UTC-NIST``, ...). It counts from its epoch until the next,
moved on by a CLOCK_DRIFT of the same epoch. Before the first record nothing is known.

Source: CCSDS 503.0-B-2 (2020), section 3.5.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radioloc.earth.stations import StationCatalogue, station_name
from radioloc.io.tdm.agreement import TdmAgreement
from radioloc.io.tdm.keywords import CLOCKS, MEASURED, RECEIVED, SENT, SENT_RATE
from radioloc.io.tdm.message import TdmSegment
from radioloc.measurements.ramps import Ramps
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


class SeriesPart(NamedTuple):
    """Records of one segment: keywords of a quantity and of its rate; what to add to their epochs and values."""

    segment: TdmSegment
    keyword: str
    rate_keyword: str
    delay_s: float = 0.0
    correction: float = 0.0


class Series:
    """A quantity that is given at some epochs, each time with the rate at which it changes until the next.

    ``origin`` is file and line of the first record, ``start`` its epoch (UTC), from which the records are ``since_s``
    seconds. A rate lasts until the next rate, or (``rates_last`` false) until the next record.
    """

    def __init__(self, parts: Sequence[SeriesPart], *, rates_last: bool) -> None:
        first = parts[0].segment
        self.origin = f"{first.path}, line {first.line[0]}"
        self.start = first.epoch[[0]]
        self.segments = [part.segment for part in parts]

        def times_of(part: SeriesPart, keyword: str) -> NDArray[np.float64]:
            return seconds_from(self.start, part.segment.epochs(keyword)) + part.delay_s

        time = np.concatenate([times_of(part, part.keyword) for part in parts])
        rate_times = [times_of(part, part.rate_keyword) for part in parts]
        for part, mine in zip(parts, rate_times, strict=True):
            alone = ~np.isin(mine, time)
            if alone.any():
                problem = f"{part.rate_keyword} has no {part.keyword} at its epoch, from which it would run; add that"
                raise part.segment.fail(part.rate_keyword, problem, int(np.argmax(alone)))
        order = np.argsort(time, kind="stable")
        rate_time = np.concatenate(rate_times)
        rate_order = np.argsort(rate_time, kind="stable")
        self.since_s = time[order]
        self.value = np.concatenate([p.segment.values(p.keyword) + p.correction for p in parts])[order]
        rates = np.concatenate([part.segment.values(part.rate_keyword) for part in parts])
        steps = np.concatenate([[0.0], rates[rate_order]])
        self.rate = steps[np.searchsorted(rate_time[rate_order], self.since_s, side="right")]
        if not rates_last:
            self.rate = np.where(np.isin(self.since_s, rate_time), self.rate, 0.0)

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

    def ramps(self, station: str, until: Epochs) -> Ramps:
        """A station's transmitted frequency until an epoch (UTC), by its clock."""
        last_s = max(float(seconds_from(self.start, until)[0]), self.since_s[-1])
        start, stop_s = self._epochs(self.since_s), np.append(self.since_s[1:], last_s)
        return Ramps.of([station] * len(start), start, self._epochs(stop_s), self.value, self.rate)

    def _epochs(self, since_s: NDArray[np.float64]) -> Epochs:
        return shifted_utc(self.start[np.zeros(len(since_s), dtype=int)], since_s)

    def _row(self, since: NDArray[np.float64]) -> NDArray[np.intp]:
        return np.searchsorted(self.since_s, since, side="right") - 1


class Reading:
    """The segments of one reading, what they say for each other, and what was done with them.

    ``used`` are the segments and data keywords that observations were made of or with.
    """

    def __init__(
        self, segments: Sequence[TdmSegment], agreement: TdmAgreement, catalogue: StationCatalogue | None
    ) -> None:
        self.segments, self.agreement, self.catalogue = segments, agreement, catalogue
        self.files = tuple(dict.fromkeys(segment.path for segment in segments))
        self.used: set[tuple[TdmSegment, str]] = set()
        self.notes: list[str] = []
        self._clocks = self._clock_differences() if agreement.apply_clocks else {}
        self._sent = self._sent_frequencies()

    def station(self, segment: TdmSegment, number: int) -> str:
        """The catalogue's name of a participant, or the file's where the catalogue does not know it."""
        return self.catalogue_name(segment.participant(number))

    def catalogue_name(self, name: str) -> str:
        """The catalogue's name of a station, or the name itself where the catalogue does not know it."""
        return station_name(self.catalogue, name)

    def key(self, name: str) -> str:
        """Text by which the same participant is known again in another segment.

        Case does not matter, and an underscore is a blank (4.3.7, 4.3.8).
        """
        return " ".join(canonical_target(station_name(self.catalogue, name)).replace("_", " ").split())

    def models_delay(self, station: str, way: str) -> bool:
        """Whether the model has the delay of a station on the way out or in (``"transmit"``, ``"receive"``)."""
        known = self.agreement.modelled.stations.items()
        mine = [delay for name, delay in known if self.key(name) == self.key(station)]
        return any(getattr(delay, f"{way}_s") is not None for delay in mine)

    def _clock_differences(self) -> dict[tuple[str, str], Series]:
        """Clock of the second participant less that of the first, s, by the keys of both."""
        found: dict[tuple[str, str], list[SeriesPart]] = {}
        for segment in self.segments:
            if not set(CLOCKS) & set(segment.counts()):
                continue
            keys = []
            for number in (1, 2):
                if f"PARTICIPANT_{number}" not in segment.metadata:
                    problem = (
                        f"CLOCK_BIAS is the difference of two clocks, but PARTICIPANT_{number} is missing"
                    )
                    raise segment.fail("", problem)
                name = segment.participant(number)
                keys.append(_UTC if name.upper().startswith("UTC") else self.key(name))
            found.setdefault((keys[0], keys[1]), []).append(SeriesPart(segment, *CLOCKS))
        return {pair: Series(parts, rates_last=False) for pair, parts in found.items()}

    def clock_difference(self, first: str, second: str = _UTC) -> list[tuple[float, Series]]:
        """Clock of the second participant (of UTC) less that of the first, as a sum of signed known differences.

        Records of the two themselves count; where there are none, those of each to UTC. A clock of which nothing is
        said shows UTC (the standard's default). Empty where nothing is said of either.
        """

        def signed(one: str, other: str) -> list[tuple[float, Series]]:
            for sign, pair in ((1.0, (one, other)), (-1.0, (other, one))):
                if pair in self._clocks:
                    return [(sign, self._clocks[pair])]
            return []

        if first == second:
            return []
        return signed(first, second) or signed(first, _UTC) + signed(_UTC, second)

    def _sent_frequencies(self) -> dict[tuple[str, str], list[tuple[TdmSegment, int]]]:
        """Segments and participants of which sent frequencies are given, by the keys of sender and first receiver."""
        found: dict[tuple[str, str], list[tuple[TdmSegment, int]]] = {}
        for segment in self.segments:
            held, path = segment.counts(), segment.legs()
            for n, keywords in enumerate(zip(SENT, SENT_RATE, strict=True), start=1):
                there = [keyword for keyword in keywords if keyword in held]
                if not there or segment.metadata.get("MODE") == "SINGLE_DIFF":
                    continue
                if n not in path[:-1]:
                    problem = f"is there, but on its PATH participant {n} sends nothing; correct one"
                    raise segment.fail(there[0], f"{keywords[0]} {problem}")
                ends = (n, path[path.index(n) + 1])
                sender, to = (self.key(segment.participant(number)) for number in ends)
                found.setdefault((sender, to), []).append((segment, n))
        return found

    def frequency_sent(self, segment: TdmSegment, sender: int, to: int) -> Series | None:
        """Frequency that a participant of a segment sends to another: of the segment itself, else of its band.

        Others are segments that hold no measurement: a frequency that stands beside measurements is that of these.
        Where received frequencies need it and there is none such, it is looked for there too.
        """
        pair = self.key(segment.participant(sender)), self.key(segment.participant(to))
        parts = self._sent.get(pair, [])
        if (segment, sender) in parts:
            parts = [(segment, sender)]
        else:
            needed = set(RECEIVED) & set(segment.counts())
            alone = [part for part in parts if not set(MEASURED) & set(part[0].counts())]
            parts = parts if needed and not alone else alone
            band = segment.metadata.get("TRANSMIT_BAND", "").upper()
            bands = [other.metadata.get("TRANSMIT_BAND", "").upper() for other, _ in parts]
            if band:
                chosen = band if band in bands else ""
                parts = [part for part, other in zip(parts, bands, strict=True) if other == chosen]
            elif len(set(bands)) > 1:
                several = f"is given in several bands ({', '.join(sorted(filter(None, set(bands))))})"
                problem = f"{SENT[sender - 1]} {several}; say TRANSMIT_BAND where it is used"
                raise parts[0][0].fail("TRANSMIT_BAND", problem)
        joined = []
        for other, number in parts:
            keyword, correction_hz = SENT[number - 1], other.correction("TRANSMIT")
            wrong = ~(other.values(keyword) + correction_hz > 0.0)
            if wrong.any():
                raise other.fail(keyword, f"{keyword} must be above zero", int(np.argmax(wrong)))
            # Epochs are those of the transmitter's electronics; the signal leaves the antenna later.
            gone = self.agreement.delays_removed or self.models_delay(other.participant(number), "transmit")
            delay_s = 0.0 if gone else other.number(f"TRANSMIT_DELAY_{number}")
            joined.append(SeriesPart(other, keyword, SENT_RATE[number - 1], delay_s, correction_hz))
        return Series(joined, rates_last=True) if joined else None
