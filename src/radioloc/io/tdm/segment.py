"""Common parts of the measurements of a segment: path, time tags, delays, clocks, frequencies and weather.

Time tags are converted to UTC of the event at the station's reference point: RECEIVE_DELAY_n shifts a reception
earlier, TRANSMIT_DELAY_n shifts a transmission later, clock errors are subtracted, and a Doppler tag moves from the
start or the end of its count interval to the middle. Delays of the stations and of the transponder are subtracted from
the light path.

A frequency TRANSMIT_FREQ_n holds from its epoch on, and TRANSMIT_FREQ_RATE_n from then until the next record of a rate
(3.5.2.9, 3.5.2.10). A record CLOCK_BIAS is the reading of the clock of participant 2 less that of participant 1
(3.5.6.1); either may be UTC itself (``UTC``, ``UTC-NIST``, ...). It holds from its epoch until the next, with a
CLOCK_DRIFT of the same epoch. Both also hold for measurements in other segments. TEMPERATURE (K), PRESSURE (hPa) and
RHUMIDITY are interpolated as those of laser ranging files.

Source: CCSDS 503.0-B-2 (2020), sections 3.3 to 3.5.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from radioloc.constants import C_M_S
from radioloc.earth.stations import StationCatalogue, station_name
from radioloc.errors import FileFormatError, InputError
from radioloc.io.checks import weather_at
from radioloc.io.frequencies import MAX_DURATION_S, MICROMETRES, agreement_for
from radioloc.io.tdm.agreement import TdmAgreement
from radioloc.io.tdm.message import CLOCKS, MEASURED, RECEIVED, SENT, SENT_RATE, WEATHER, TdmSegment
from radioloc.measurements.link import Link, canonical_target
from radioloc.measurements.ramps import Ramps
from radioloc.measurements.table_columns import FLIGHT_TIME_LIMITS_S
from radioloc.time import Epochs, tai_to_utc, utc_to_tai
from radioloc.vectors import Floats

_UTC = "utc"
_MAX_LIGHT_TIME_S = 3600.0  # of the round trip to targets beyond the Moon


def shifted_utc(utc: Epochs, shift_s: ArrayLike) -> Epochs:
    """Return epochs shifted by SI seconds, across leap seconds; epochs with zero shift stay exact."""
    jd, fraction, shift = (np.array(column) for column in np.broadcast_arrays(utc.jd, utc.fraction, shift_s))
    moved = shift != 0.0
    new = tai_to_utc(utc_to_tai(Epochs(jd[moved], fraction[moved], "UTC")).shifted(shift[moved]))
    jd[moved], fraction[moved] = new.jd, new.fraction
    return Epochs(jd, fraction, "UTC")


def seconds_from(start: Epochs, utc: Epochs) -> Floats:
    """Return SI seconds from one epoch to others, all UTC, shape (n,)."""
    return utc_to_tai(utc).seconds_since(utc_to_tai(start)) if len(utc) else np.empty(0)


class SeriesPart(NamedTuple):
    """Records of one segment: keywords of a quantity and of its rate, and offsets of their epochs and values."""

    segment: TdmSegment
    keyword: str
    rate_keyword: str
    delay_s: float = 0.0
    correction: float = 0.0


class Series:
    """Piecewise linear quantity: values at epochs, with the rate until the next epoch."""

    def __init__(self, parts: Sequence[SeriesPart], *, rates_last: bool) -> None:
        # A rate lasts until the next rate, or (rates_last false) until the next record.
        first = parts[0].segment
        self.origin = f"{first.path}, line {first.line_of(parts[0].keyword)}"
        self.start = first.epoch[[0]]
        self.segments = [part.segment for part in parts]

        def times_of(part: SeriesPart, keyword: str) -> Floats:
            return seconds_from(self.start, part.segment.epochs(keyword)) + part.delay_s

        time = np.concatenate([times_of(part, part.keyword) for part in parts])
        rate_times = [times_of(part, part.rate_keyword) for part in parts]
        for part, part_time in zip(parts, rate_times, strict=True):
            unmatched = ~np.isin(part_time, time)
            if unmatched.any():
                problem = (
                    f"{part.rate_keyword}: expected a {part.keyword} at its epoch, from which it runs; add it"
                )
                raise part.segment.fail(part.rate_keyword, problem, int(np.argmax(unmatched)))
        order = np.argsort(time, kind="stable")
        rate_time = np.concatenate(rate_times)
        rate_order = np.argsort(rate_time, kind="stable")
        self.since_s = time[order]
        self.value = np.concatenate([p.segment.values(p.keyword) + p.correction for p in parts])[order]
        if (different := (np.diff(self.since_s) == 0.0) & (np.diff(self.value) != 0.0)).any():
            row = int(np.argmax(different))
            owners = np.repeat(np.arange(len(parts)), [len(times_of(p, p.keyword)) for p in parts])
            part = parts[owners[order][row + 1]]
            values = f"{float(self.value[row])!r} and {float(self.value[row + 1])!r}"
            problem = f"{part.keyword} has two values of one epoch in two segments, {values}; leave one out"
            raise part.segment.fail(part.keyword, problem)
        rates = np.concatenate([part.segment.values(part.rate_keyword) for part in parts])
        steps = np.concatenate([[0.0], rates[rate_order]])
        self.rate = steps[np.searchsorted(rate_time[rate_order], self.since_s, side="right")]
        if not rates_last:
            self.rate = np.where(np.isin(self.since_s, rate_time), self.rate, 0.0)

    @property
    def is_constant(self) -> bool:
        """Return whether all values are equal, without rates."""
        return bool((self.value == self.value[0]).all() and not self.rate.any())

    def interpolate(self, utc: Epochs) -> Floats:
        """Return the quantity at epochs (UTC), shape (n,); NaN before the first record."""
        since = seconds_from(self.start, utc)
        row = np.searchsorted(self.since_s, since, side="right") - 1
        value = self.value[row] + self.rate[row] * (since - self.since_s[row])
        return np.where(row < 0, np.nan, value)

    def ramps(self, station: str, until: Epochs) -> Ramps:
        """Return a station's transmitted frequency until an epoch (UTC), by its clock."""
        last_s = max(float(seconds_from(self.start, until)[0]), self.since_s[-1])
        stop_s = np.append(self.since_s[1:], last_s)
        start, stop = (shifted_utc(self.start, since_s) for since_s in (self.since_s, stop_s))
        return Ramps.from_columns([station] * len(start), start, stop, self.value, self.rate)


class Reading:
    """Segments that are read together, with the frequencies, clocks and weather that they state for each other."""

    def __init__(
        self, segments: Sequence[TdmSegment], agreement: TdmAgreement, catalogue: StationCatalogue | None
    ) -> None:
        self.segments, self.agreement, self.catalogue = segments, agreement, catalogue
        self.files = tuple(dict.fromkeys(segment.path for segment in segments))
        self.used: set[tuple[TdmSegment, str]] = set()
        self.notes: list[str] = []
        self.without_sigma: dict[str, FileFormatError] = {}  # by type of measurement
        self._clocks = self._clock_differences() if agreement.apply_clocks else {}
        self._sent = self._sent_frequencies()

    def station(self, name: str) -> str:
        """Return the catalogue's name of a station, or the name itself for a station that is not in it."""
        return station_name(self.catalogue, name)

    def key(self, name: str) -> str:
        """Return the text by which participants are compared, without case and underscores (4.3.7, 4.3.8)."""
        return " ".join(canonical_target(self.station(name)).replace("_", " ").split())

    def models_delay(self, station: str, way: str) -> bool:
        """Return whether the model has the delay of a station on the way ``"transmit"`` or ``"receive"``."""
        stations = self.agreement.modelled.stations.items()
        delays = [delay for name, delay in stations if self.key(name) == self.key(station)]
        return any(getattr(delay, f"{way}_s") is not None for delay in delays)

    def _clock_differences(self) -> dict[tuple[str, str], Series]:
        """Return the clock of the second participant less that of the first, s, by the keys of both."""
        parts_by_pair: dict[tuple[str, str], list[SeriesPart]] = {}
        for segment in self.segments:
            if not set(CLOCKS) & set(segment.counts()):
                continue
            keys = []
            for number in (1, 2):
                if f"PARTICIPANT_{number}" not in segment.metadata:
                    raise segment.fail(
                        "", f"CLOCK_BIAS needs two clocks, but PARTICIPANT_{number} is missing"
                    )
                name = segment.participant(number)
                keys.append(_UTC if name.upper().startswith("UTC") else self.key(name))
            parts_by_pair.setdefault((keys[0], keys[1]), []).append(SeriesPart(segment, *CLOCKS))
        return {pair: Series(parts, rates_last=False) for pair, parts in parts_by_pair.items()}

    def clock_difference(self, first: str, second: str = _UTC) -> list[tuple[float, Series]]:
        """Return the clock of the second participant (or UTC) less that of the first, as signed series."""

        def signed(start: str, end: str) -> list[tuple[float, Series]]:
            for sign, pair in ((1.0, (start, end)), (-1.0, (end, start))):
                if pair in self._clocks:
                    return [(sign, self._clocks[pair])]
            return []

        if first == second:
            return []
        # A clock without records shows UTC (the standard's default).
        return signed(first, second) or signed(first, _UTC) + signed(_UTC, second)

    def _sent_frequencies(self) -> dict[tuple[str, str], list[tuple[TdmSegment, int]]]:
        """Return segments and participants with sent frequencies, by the keys of sender and first receiver."""
        senders: dict[tuple[str, str], list[tuple[TdmSegment, int]]] = {}
        for segment in self.segments:
            held, path = segment.counts(), segment.legs()
            for n, keywords in enumerate(zip(SENT, SENT_RATE, strict=True), start=1):
                stated = [keyword for keyword in keywords if keyword in held]
                if not stated or segment.metadata.get("MODE") == "SINGLE_DIFF":
                    continue
                if n not in path[:-1]:
                    raise segment.fail(
                        stated[0], f"{keywords[0]}: participant {n} of PATH is not a sender; correct one"
                    )
                ends = (n, path[path.index(n) + 1])
                sender, to = (self.key(segment.participant(number)) for number in ends)
                senders.setdefault((sender, to), []).append((segment, n))
        return senders

    def frequency_sent(self, segment: TdmSegment, sender: int, to: int) -> Series | None:
        """Return the frequency that a participant sends to another, of the segment or else of its band."""
        pair = self.key(segment.participant(sender)), self.key(segment.participant(to))
        parts = self._sent.get(pair, [])
        if (segment, sender) in parts:
            parts = [(segment, sender)]
        else:
            # A frequency beside measurements belongs to these, unless received frequencies need it.
            needed = set(RECEIVED) & set(segment.counts())
            separate = [part for part in parts if not set(MEASURED) & set(part[0].counts())]
            parts = parts if needed and not separate else separate
            band = segment.metadata.get("TRANSMIT_BAND", "").upper()
            bands = [source.metadata.get("TRANSMIT_BAND", "").upper() for source, _ in parts]
            if band:
                chosen = band if band in bands else ""
                parts = [part for part, part_band in zip(parts, bands, strict=True) if part_band == chosen]
            elif len(set(bands)) > 1:
                several = f"is given in several bands ({', '.join(sorted(filter(None, set(bands))))})"
                problem = f"{SENT[sender - 1]} {several}; add TRANSMIT_BAND to the measurements"
                raise parts[0][0].fail("TRANSMIT_BAND", problem)
        joined = []
        for source, number in parts:
            keyword, correction_hz = SENT[number - 1], source.correction("TRANSMIT")
            wrong = ~(source.values(keyword) + correction_hz > 0.0)
            if wrong.any():
                raise source.fail(keyword, f"{keyword}: expected a value above zero", int(np.argmax(wrong)))
            # Epochs are those of the transmitter's electronics; the signal leaves the antenna later.
            removed = self.agreement.delays_removed or self.models_delay(
                source.participant(number), "transmit"
            )
            delay_s = 0.0 if removed else source.number(f"TRANSMIT_DELAY_{number}")
            joined.append(SeriesPart(source, keyword, SENT_RATE[number - 1], delay_s, correction_hz))
        return Series(joined, rates_last=True) if joined else None


class SegmentReader:
    """Reader of one segment; sender, target and receiver are numbers of participants (of delays two stations)."""

    def __init__(self, reading: Reading, segment: TdmSegment) -> None:
        self.reading, self.segment = reading, segment
        self.agreement, self.fail = reading.agreement, segment.fail
        self.link, (self.sender, self.target, self.receiver) = _link(reading, segment)
        self.one_way = self.sender == self.target
        self.down_only = self.one_way or self.link.differenced
        self.key = [reading.key(segment.participant(n)) for n in (self.sender, self.receiver)]
        self.tag = segment.metadata.get("TIMETAG_REF", "RECEIVE").lower()
        self.sent = None if self.link.differenced else reading.frequency_sent(segment, *segment.legs()[:2])
        self.agreed = agreement_for(segment.path, self.agreement.frequencies)

    def note(self, text: str) -> None:
        """Record a correction of the data."""
        self.reading.notes.append(f"{self.link.path}: {text}")

    def less_delays(self, keyword: str, value_m: Floats, delay_s: float, correction_m: float = 0.0) -> Floats:
        """Return values corrected for equipment delays and the clock difference of the ends."""
        clock_s = self.clock_s(keyword, *self.key)
        if delay_s:
            self.note(f"equipment delay of {delay_s:.9g} s subtracted")
        if clock_s.any():
            self.note(f"clock difference of {clock_s[0]:.6g} s subtracted")
        if correction_m:
            self.note(f"correction of {correction_m:.9g} m added")
        return value_m + (correction_m - C_M_S * (delay_s + clock_s))

    def delay_s(self, *names: str) -> float:
        """Return the sum of the delays in the data that the model lacks, s."""
        if self.agreement.delays_removed:
            return 0.0
        modelled = [name for name in names if name in self.segment.metadata and self.is_modelled(name)]
        self.reading.notes += [f"{name} stays in the data: the model has that delay" for name in modelled]
        return sum(self.segment.number(name) for name in names if name not in modelled)

    def differenced_delay_s(self) -> float:
        """Return the delay of the second station's reception less that of the first's in the data, s."""
        return self.delay_s(f"RECEIVE_DELAY_{self.receiver}") - self.delay_s(f"RECEIVE_DELAY_{self.sender}")

    def is_modelled(self, name: str) -> bool:
        """Return whether the model has the delay of a keyword."""
        way, _, number = name.partition("_DELAY_")
        if int(number) == self.target:
            return self.agreement.modelled.transponder_s is not None and not self.one_way
        return self.reading.models_delay(self.segment.participant(int(number)), way.lower())

    def clock_s(self, keyword: str, *ends: str) -> Floats:
        """Return the clock difference of one participant and another (or UTC) at a keyword's epochs, s."""
        epoch = self.segment.epochs(keyword)
        total = np.zeros(len(epoch))
        for sign, difference in self.reading.clock_difference(*ends):
            value = difference.interpolate(epoch)
            if np.isnan(value).any():
                problem = f"{keyword} precedes the first CLOCK_BIAS of its station ({difference.origin})"
                advice = "add an earlier one, or set apply_clocks = False (in a study file tdm_apply_clocks = false)"
                raise self.fail(keyword, f"{problem}; {advice}", int(np.argmax(np.isnan(value))))
            if (np.abs(value) > MAX_DURATION_S).any():
                raise self.fail(
                    "", f"CLOCK_BIAS ({difference.origin}) exceeds a day; correct it or its drift"
                )
            total += sign * value
            self.reading.used |= {(segment, name) for segment in difference.segments for name in CLOCKS}
        return total

    def tagged(self, keyword: str, middle_s: float = 0.0) -> Epochs:
        """Return the epochs of a keyword's records at the station's reference point, later by ``middle_s``."""
        at_first = self.tag == "transmit" or self.link.differenced
        station, number = (self.key[0], self.sender) if at_first else (self.key[1], self.receiver)
        sign, way = (1.0, "TRANSMIT") if self.tag == "transmit" else (-1.0, "RECEIVE")
        delay_s = sign * self.delay_s(f"{way}_DELAY_{number}")
        clock_s = self.clock_s(keyword, station)
        if clock_s.any() or delay_s:
            of_clock = f" and by the clock of {station}" if clock_s.any() else ""
            self.note(f"{self.tag} time tags shifted by {delay_s:.9g} s of delay{of_clock}")
        return shifted_utc(self.segment.epochs(keyword), middle_s + delay_s + clock_s)

    def turnaround(self) -> tuple[int, int] | None:
        """Return the transponder's ratio of the file or else of the agreement; 1/1 of the target's own signal."""
        keywords = [f"TURNAROUND_{part}" for part in ("NUMERATOR", "DENOMINATOR")]
        stated = [name for name in keywords if name in self.segment.metadata]
        if len(stated) == 1:
            raise self.fail(stated[0], f"expected {keywords[0]} and {keywords[1]}, got {stated[0]} only")
        if self.one_way:
            return 1, 1
        if not stated:
            return self.agreement.turnaround
        return int(self.segment.number(keywords[0])), int(self.segment.number(keywords[1]))

    def cycles(self, keyword: str, base_hz: float) -> dict[str, Any]:
        """Return the columns of observations that count cycles of a changing frequency, by a reference."""
        if self.sent is None or (self.sent.is_constant and keyword == "RANGE"):  # the agreement has its unit
            return {}
        # Observations that may have been sent before the first record of a constant frequency are ramped too, and the
        # model rejects those that were.
        after_s = seconds_from(self.sent.start, self.segment.epochs(keyword)) - self.sent.since_s[0]
        if early := int((after_s < 0.0).sum()):
            self.note(f"{early} {keyword} are before the first transmitted frequency ({self.sent.origin})")
        ramped = np.ones(len(after_s), dtype=bool)
        if self.sent.is_constant:
            longest_s = FLIGHT_TIME_LIMITS_S[1] if self.agreement.lunar else _MAX_LIGHT_TIME_S
            ramped = after_s < self.segment.number("INTEGRATION_INTERVAL") + longest_s
            if not ramped.any():
                return {}
        # The last ramp lasts until the end of the last count.
        end_s = self.segment.number("INTEGRATION_INTERVAL")
        until = shifted_utc(self.segment.epochs(keyword)[[-1]], end_s)
        name, reference = self.link.transmitter, {"uplink_hz": base_hz}
        if self.one_way:
            name, reference = self.link.target, {"wavelength_um": MICROMETRES * C_M_S / base_hz}
        return {"ramped": ramped, "ramps": self.sent.ramps(name, until)} | reference

    def beacon_hz(self, keyword: str) -> float:
        """Return the single frequency that the target of two paths sends, NaN where it is unknown."""
        beacon = SENT[self.target - 1]
        if len(sent := self.segment.values(beacon)) and (sent == sent[0]).all() and sent[0] > 0.0:
            early = seconds_from(self.segment.epochs(beacon)[[0]], self.segment.epochs(keyword)) < 0.0
            if early.any():
                problem = f"{keyword} precedes the first {beacon}; add an earlier one"
                raise self.fail(keyword, problem, int(np.argmax(early)))
            self.reading.used.add((self.segment, beacon))
            return float(sent[0])
        return np.nan if self.agreed is None else self.agreed.received_hz

    def frequencies(self, keyword: str) -> dict[str, Any]:
        """Return the frequency sent up at the time tags and the wavelength received, NaN where not recorded."""
        if self.link.differenced:
            return {"wavelength_um": MICROMETRES * C_M_S / self.beacon_hz(keyword)}
        epoch, used = self.segment.epochs(keyword), self.reading.used
        # The frequency at the time tags suffices for dispersive delays.
        sent_hz = np.full(len(epoch), np.nan)
        if self.sent is not None:
            used |= {(segment, name) for segment in self.sent.segments for name in (*SENT, *SENT_RATE)}
            sent_hz = self.sent.interpolate(epoch)
        received = [k for k in ("RECEIVE_FREQ", RECEIVED[self.receiver]) if k in self.segment.counts()]
        if received:
            frequency = self.segment.values(received[0]) + self.segment.number("FREQ_OFFSET")
            times = self.segment.epochs(received[0])
            since_s, epoch_s = (seconds_from(times[[0]], utc) for utc in (times, epoch))
            place = np.searchsorted(since_s, epoch_s, side="right") - 1
            hz = np.where((place >= 0) & (frequency[place] > 0.0), frequency[place], np.nan)
            used.add((self.segment, received[0]))
        else:
            up, down = self.turnaround() or (np.nan, 1)
            hz = sent_hz * up / down
        uplink_hz = np.nan if self.one_way else sent_hz
        return {"uplink_hz": uplink_hz, "wavelength_um": MICROMETRES * C_M_S / hz}

    def weather(self, keyword: str) -> dict[str, Floats]:
        """Return weather columns at a keyword's epochs, of the segment or of segments without a path (3.3.2.7)."""
        places = [self.segment] if set(WEATHER) & set(self.segment.counts()) else []
        # Observations of two stations have one weather record only, that of their segment.
        if not places and (self.one_way or self.key[0] == self.key[1]):
            places = [
                segment
                for segment in self.reading.segments
                if set(WEATHER) & set(segment.counts())
                and "PATH" not in segment.metadata
                and "PARTICIPANT_1" in segment.metadata
                and self.reading.key(segment.participant(1)) == self.key[1]
            ]
        self.reading.used |= {(segment, name) for segment in places for name in WEATHER}
        out = {}
        for name, column in WEATHER.items():
            values = np.concatenate([np.empty(0), *(segment.values(name) for segment in places)])
            if len(values):
                start = places[0].epoch[[0]]
                times = np.concatenate([seconds_from(start, segment.epochs(name)) for segment in places])
                out[column] = weather_at(times, values, seconds_from(start, self.segment.epochs(keyword)))
        return out


def _link(reading: Reading, segment: TdmSegment) -> tuple[Link, tuple[int, int, int]]:
    """Return the link of a segment by MODE, paths and participants, and the numbers of these."""
    mode = segment.metadata.get("MODE")
    if mode is None:
        raise segment.fail("", "MODE is missing in the metadata; add MODE = SEQUENTIAL or SINGLE_DIFF")
    keywords = ("PATH",) if mode == "SEQUENTIAL" else ("PATH_1", "PATH_2")
    for keyword in keywords:
        if keyword not in segment.metadata:
            raise segment.fail("MODE", f"MODE is {mode}, but {keyword} is missing; add it")
    paths = [segment.legs(keyword) for keyword in keywords]
    shown = " and ".join(f"{keyword} = {segment.metadata[keyword]}" for keyword in keywords)
    if len(paths) == 2:
        first, second = paths[0][-1], paths[1][-1]
        if paths[0][:-1] != paths[1][:-1] or len(paths[0]) > 3 or first == second:
            expected = "expected two paths that differ in the last station, such as 1,2 and 1,3"
            raise segment.fail("PATH_1", f"{expected}, got {shown}")
        target = paths[0][-2]
    elif len(paths[0]) > 3:
        expected = "expected a path from station to target to station, such as 1,2,1, or from the target: 2,1"
        raise segment.fail("PATH", f"{expected}; got {shown}")
    else:
        first, target, second = ([paths[0][0]] + paths[0])[-3:]
    one_way = len(paths[0]) == 2 and len(paths) == 1
    if target == second or (target == first and not one_way):
        raise segment.fail(keywords[0], f"{shown} has the target among the stations; correct it")
    if segment.participant(target).upper() == "UNKNOWN":
        raise segment.fail(f"PARTICIPANT_{target}", "the target is UNKNOWN; name it")
    sender = "" if one_way else reading.station(segment.participant(first))
    receiver = reading.station(segment.participant(second))
    try:
        link = Link(sender, canonical_target(segment.participant(target)), receiver, len(paths) == 2)
    except InputError as error:
        raise segment.fail(f"PARTICIPANT_{target}", str(error)) from None
    return link, (first, target, second)
