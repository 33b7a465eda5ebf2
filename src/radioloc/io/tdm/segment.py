"""What all measurements of a segment share: path, time tags, delays, clocks, frequencies and weather.

Time tags are made those of the event at the station's reference point in UTC: RECEIVE_DELAY_n takes a reception back,
TRANSMIT_DELAY_n moves a transmission on, a clock's known error is taken off, and a Doppler tag goes from the
start or the end of its count interval to the middle. The delays of the stations and of the transponder are taken off
the light path.

A frequency TRANSMIT_FREQ_n is that from its epoch on, and TRANSMIT_FREQ_RATE_n its rate from then until the next record
of a rate (3.5.2.9, 3.5.2.10). A record CLOCK_BIAS holds the reading of the clock of participant 2 less that of
participant 1 (3.5.6.1); either may be UTC itself (``UTC``, ``UTC-NIST``, ...). It counts from its epoch until the next,
moved on by a CLOCK_DRIFT of the same epoch. Before the first record nothing is known. Both are said for measurements in
other segments, too. TEMPERATURE (K), PRESSURE (hPa) and RHUMIDITY are interpolated as those of laser ranging files.

Source: CCSDS 503.0-B-2 (2020), sections 3.3 to 3.5.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from radioloc.constants import C_M_S
from radioloc.earth.stations import StationCatalogue, station_name
from radioloc.errors import InputError
from radioloc.io.checks import weather_near
from radioloc.io.frequencies import LONGEST_S, MICROMETRES, agreement_on
from radioloc.io.tdm.agreement import TdmAgreement
from radioloc.io.tdm.message import CLOCKS, MEASURED, RECEIVED, SENT, SENT_RATE, WEATHER, TdmSegment
from radioloc.measurements.link import Link, canonical_target
from radioloc.measurements.ramps import Ramps
from radioloc.measurements.table_columns import FLIGHT_TIME_LIMITS_S
from radioloc.time import Epochs, tai_to_utc, utc_to_tai
from radioloc.vectors import Floats

_UTC = "utc"
_MAX_LIGHT_TIME_S = 3600.0  # there and back, to targets that are not at the Moon


def shifted_utc(utc: Epochs, shift_s: ArrayLike) -> Epochs:
    """Return epochs later by SI seconds, over leap seconds where need be; those not moved keep their last bit."""
    jd, fraction, shift = (np.array(column) for column in np.broadcast_arrays(utc.jd, utc.fraction, shift_s))
    moved = shift != 0.0
    new = tai_to_utc(utc_to_tai(Epochs(jd[moved], fraction[moved], "UTC")).shifted(shift[moved]))
    jd[moved], fraction[moved] = new.jd, new.fraction
    return Epochs(jd, fraction, "UTC")


def seconds_from(start: Epochs, utc: Epochs) -> Floats:
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
    """Quantity given at some epochs, each time with the rate at which it changes until the next."""

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
        if (other := (np.diff(self.since_s) == 0.0) & (np.diff(self.value) != 0.0)).any():
            row = int(np.argmax(other))
            after = np.repeat(np.arange(len(parts)), [len(times_of(p, p.keyword)) for p in parts])[order][
                row + 1
            ]
            values = f"{float(self.value[row])!r} and {float(self.value[row + 1])!r}"
            problem = (
                f"{parts[after].keyword} has two values of one epoch in two segments, {values}; leave one out"
            )
            raise parts[after].segment.fail(parts[after].keyword, problem)
        rates = np.concatenate([part.segment.values(part.rate_keyword) for part in parts])
        steps = np.concatenate([[0.0], rates[rate_order]])
        self.rate = steps[np.searchsorted(rate_time[rate_order], self.since_s, side="right")]
        if not rates_last:
            self.rate = np.where(np.isin(self.since_s, rate_time), self.rate, 0.0)

    @property
    def constant(self) -> bool:
        """Whether there is but one value."""
        return bool((self.value == self.value[0]).all() and not self.rate.any())

    def at(self, utc: Epochs) -> Floats:
        """The quantity at epochs (UTC), shape (n,); NaN before the first record."""
        since = seconds_from(self.start, utc)
        row = np.searchsorted(self.since_s, since, side="right") - 1
        value = self.value[row] + self.rate[row] * (since - self.since_s[row])
        return np.where(row < 0, np.nan, value)

    def ramps(self, station: str, until: Epochs) -> Ramps:
        """A station's transmitted frequency until an epoch (UTC), by its clock."""
        last_s = max(float(seconds_from(self.start, until)[0]), self.since_s[-1])
        stop_s = np.append(self.since_s[1:], last_s)
        start, stop = (shifted_utc(self.start, since_s) for since_s in (self.since_s, stop_s))
        return Ramps.of([station] * len(start), start, stop, self.value, self.rate)


class Reading:
    """Segments of one reading, with the frequencies, clocks and weather that they state for each other."""

    def __init__(
        self, segments: Sequence[TdmSegment], agreement: TdmAgreement, catalogue: StationCatalogue | None
    ) -> None:
        self.segments, self.agreement, self.catalogue = segments, agreement, catalogue
        self.files = tuple(dict.fromkeys(segment.path for segment in segments))
        self.used: set[tuple[TdmSegment, str]] = set()
        self.notes: list[str] = []
        self._clocks = self._clock_differences() if agreement.apply_clocks else {}
        self._sent = self._sent_frequencies()

    def station(self, name: str) -> str:
        """The catalogue's name of a station, or the name itself where the catalogue does not know it."""
        return station_name(self.catalogue, name)

    def key(self, name: str) -> str:
        """Return the text by which participants are compared, without case and underscores (4.3.7, 4.3.8)."""
        return " ".join(canonical_target(self.station(name)).replace("_", " ").split())

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
        """Return the clock of the second participant (or UTC) less that of the first, as signed series."""

        def signed(one: str, other: str) -> list[tuple[float, Series]]:
            for sign, pair in ((1.0, (one, other)), (-1.0, (other, one))):
                if pair in self._clocks:
                    return [(sign, self._clocks[pair])]
            return []

        if first == second:
            return []
        # A clock of which nothing is said shows UTC (the standard's default).
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
        """Return the frequency that a participant sends to another, of the segment itself or else of its band."""
        pair = self.key(segment.participant(sender)), self.key(segment.participant(to))
        parts = self._sent.get(pair, [])
        if (segment, sender) in parts:
            parts = [(segment, sender)]
        else:
            # A frequency beside measurements is that of these, unless received frequencies have no other.
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


class SegmentReader:
    """Reader of one segment; sender, target and receiver are numbers of participants (of a delay both stations)."""

    def __init__(self, reading: Reading, segment: TdmSegment) -> None:
        self.reading, self.segment = reading, segment
        self.agreement, self.fail = reading.agreement, segment.fail
        self.link, (self.sender, self.target, self.receiver) = _link(reading, segment)
        self.one_way = self.sender == self.target
        self.down_only = self.one_way or self.link.differenced
        self.key = [reading.key(segment.participant(n)) for n in (self.sender, self.receiver)]
        self.tag = segment.metadata.get("TIMETAG_REF", "RECEIVE").lower()
        self.sent = None if self.link.differenced else reading.frequency_sent(segment, *segment.legs()[:2])
        self.agreed = agreement_on(segment.path, self.agreement.frequencies)

    def note(self, text: str) -> None:
        """Say what was done to the data."""
        self.reading.notes.append(f"{self.link.path}: {text}")

    def less_delays(self, keyword: str, value_m: Floats, delay_s: float, correction_m: float = 0.0) -> Floats:
        """Values without delays in equipment and the difference of the clocks at the ends, and with a correction."""
        clock_s = self.clock_s(keyword, *self.key)
        if delay_s:
            self.note(f"{delay_s:.9g} s of delay in equipment taken off")
        if clock_s.any():
            self.note(f"clock difference of {clock_s[0]:.6g} s taken off")
        if correction_m:
            self.note(f"correction of {correction_m:.9g} m added")
        return value_m + (correction_m - C_M_S * (delay_s + clock_s))

    def delay_s(self, *names: str) -> float:
        """Sum of delays that are still in the data and not the model's, s."""
        if self.agreement.delays_removed:
            return 0.0
        left = [name for name in names if name in self.segment.metadata and self.is_modelled(name)]
        self.reading.notes += [f"{name} stays in the data: the model has that delay" for name in left]
        return sum(self.segment.number(name) for name in names if name not in left)

    def differenced_delay_s(self) -> float:
        """Delay of the second station's reception less that of the first's, still in the data, s."""
        return self.delay_s(f"RECEIVE_DELAY_{self.receiver}") - self.delay_s(f"RECEIVE_DELAY_{self.sender}")

    def is_modelled(self, name: str) -> bool:
        """Whether the model has the delay of a keyword."""
        way, _, number = name.partition("_DELAY_")
        if int(number) == self.target:
            return self.agreement.modelled.transponder_s is not None and not self.one_way
        return self.reading.models_delay(self.segment.participant(int(number)), way.lower())

    def clock_s(self, keyword: str, *ends: str) -> Floats:
        """Difference of the clocks of one participant and another (or UTC) at a keyword's epochs, s."""
        epoch = self.segment.epochs(keyword)
        total = np.zeros(len(epoch))
        for sign, difference in self.reading.clock_difference(*ends):
            value = difference.at(epoch)
            if np.isnan(value).any():
                problem = (
                    f"{keyword} is earlier than the first CLOCK_BIAS of its station ({difference.origin})"
                )
                advice = "add an earlier one, or set apply_clocks = False (in a study file tdm_apply_clocks = false)"
                raise self.fail(keyword, f"{problem}; {advice}", int(np.argmax(np.isnan(value))))
            if (np.abs(value) > LONGEST_S).any():
                problem = (
                    f"CLOCK_BIAS ({difference.origin}) comes to more than a day; correct it or its drift"
                )
                raise self.fail("", problem)
            total += sign * value
            self.reading.used |= {(segment, name) for segment in difference.segments for name in CLOCKS}
        return total

    def tagged(self, keyword: str, middle_s: float = 0.0) -> Epochs:
        """Epochs of a keyword's records at the station's reference point, moved on by ``middle_s``."""
        at_first = self.tag == "transmit" or self.link.differenced
        station, number = (self.key[0], self.sender) if at_first else (self.key[1], self.receiver)
        sign, way = (1.0, "TRANSMIT") if self.tag == "transmit" else (-1.0, "RECEIVE")
        delay_s = sign * self.delay_s(f"{way}_DELAY_{number}")
        clock_s = self.clock_s(keyword, station)
        if clock_s.any() or delay_s:
            of_clock = f" and by the clock of {station}" if clock_s.any() else ""
            self.note(f"{self.tag} time tags moved by {delay_s:.9g} s of delay{of_clock}")
        return shifted_utc(self.segment.epochs(keyword), middle_s + delay_s + clock_s)

    def turnaround(self) -> tuple[int, int] | None:
        """Transponder's ratio, from the file or else from the agreement; 1/1 of the target's own signal."""
        given = [f"TURNAROUND_{part}" for part in ("NUMERATOR", "DENOMINATOR")]
        there = [name for name in given if name in self.segment.metadata]
        if len(there) == 1:
            raise self.fail(there[0], f"{there[0]} stands alone; give {given[0]} and {given[1]}")
        if self.one_way:
            return 1, 1
        if not there:
            return self.agreement.turnaround
        return int(self.segment.number(given[0])), int(self.segment.number(given[1]))

    def cycles(self, keyword: str, base_hz: float) -> dict[str, Any]:
        """Return the columns of observations that count cycles of a changing frequency, by a reference."""
        if self.sent is None or (self.sent.constant and keyword == "RANGE"):  # whose unit is agreed on
            return {}
        # What may have been sent before the first record of a constant frequency is ramped too: the model rejects
        # what was.
        after_s = seconds_from(self.sent.start, self.segment.epochs(keyword)) - self.sent.since_s[0]
        if early := int((after_s < 0.0).sum()):
            self.note(f"{early} {keyword} are before the first transmitted frequency ({self.sent.origin})")
        ramped = np.ones(len(after_s), dtype=bool)
        if self.sent.constant:
            longest_s = FLIGHT_TIME_LIMITS_S[1] if self.agreement.lunar else _MAX_LIGHT_TIME_S
            ramped = after_s < self.segment.number("INTEGRATION_INTERVAL") + longest_s
            if not ramped.any():
                return {}
        # What was received to the end of the last count was sent before.
        end_s = self.segment.number("INTEGRATION_INTERVAL")
        until = shifted_utc(self.segment.epochs(keyword)[[-1]], end_s)
        name, reference = self.link.transmitter, {"uplink_hz": base_hz}
        if self.one_way:
            name, reference = self.link.target, {"wavelength_um": MICROMETRES * C_M_S / base_hz}
        return {"ramped": ramped, "ramps": self.sent.ramps(name, until)} | reference

    def beacon_hz(self, keyword: str) -> float:
        """The one frequency that the target of two paths sends, NaN where it is not known."""
        beacon = SENT[self.target - 1]
        if len(sent := self.segment.values(beacon)) and (sent == sent[0]).all() and sent[0] > 0.0:
            early = seconds_from(self.segment.epochs(beacon)[[0]], self.segment.epochs(keyword)) < 0.0
            if early.any():
                problem = f"{keyword} is earlier than the first {beacon}, which holds from its time tag on"
                raise self.fail(keyword, f"{problem}; add an earlier one", int(np.argmax(early)))
            self.reading.used.add((self.segment, beacon))
            return float(sent[0])
        return np.nan if self.agreed is None else self.agreed.received_hz

    def frequencies(self, keyword: str) -> dict[str, Any]:
        """Return the frequency sent up at the time tags and the wavelength received, NaN where not recorded."""
        if self.link.differenced:
            return {"wavelength_um": MICROMETRES * C_M_S / self.beacon_hz(keyword)}
        epoch, used = self.segment.epochs(keyword), self.reading.used
        # At the time tags: it serves dispersive delays only, which do not see that the signal left before.
        sent_hz = np.full(len(epoch), np.nan)
        if self.sent is not None:
            used |= {(segment, name) for segment in self.sent.segments for name in (*SENT, *SENT_RATE)}
            sent_hz = self.sent.at(epoch)
        received = [k for k in ("RECEIVE_FREQ", RECEIVED[self.receiver]) if k in self.segment.counts()]
        if received:
            frequency = self.segment.values(received[0]) + self.segment.number("FREQ_OFFSET")
            times = self.segment.epochs(received[0])
            since, wanted = (seconds_from(times[[0]], utc) for utc in (times, epoch))
            place = np.searchsorted(since, wanted, side="right") - 1
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
        # Observations of two stations have only one weather, and none from elsewhere.
        if not places and (self.one_way or self.key[0] == self.key[1]):
            places = [
                other
                for other in self.reading.segments
                if set(WEATHER) & set(other.counts())
                and "PATH" not in other.metadata
                and "PARTICIPANT_1" in other.metadata
                and self.reading.key(other.participant(1)) == self.key[1]
            ]
        self.reading.used |= {(other, name) for other in places for name in WEATHER}
        out = {}
        for name, column in WEATHER.items():
            values = np.concatenate([np.empty(0), *(other.values(name) for other in places)])
            if len(values):
                start = places[0].epoch[[0]]
                times = np.concatenate([seconds_from(start, other.epochs(name)) for other in places])
                wanted = seconds_from(start, self.segment.epochs(keyword))
                out[column] = weather_near(times, values, wanted)
        return out


def _link(reading: Reading, segment: TdmSegment) -> tuple[Link, tuple[int, int, int]]:
    """Return the link of a segment by MODE, paths and participants, and the numbers of these."""
    mode = segment.metadata.get("MODE")
    if mode is None:
        problem = "the metadata have no MODE, which the data need; add MODE = SEQUENTIAL or SINGLE_DIFF"
        raise segment.fail("", problem)
    wanted = ("PATH",) if mode == "SEQUENTIAL" else ("PATH_1", "PATH_2")
    for keyword in wanted:
        if keyword not in segment.metadata:
            raise segment.fail("MODE", f"MODE is {mode}, but there is no {keyword}; add it")
    paths = [segment.legs(keyword) for keyword in wanted]
    shown = " and ".join(f"{keyword} = {segment.metadata[keyword]}" for keyword in wanted)
    if len(paths) == 2:
        first, second = paths[0][-1], paths[1][-1]
        if paths[0][:-1] != paths[1][:-1] or len(paths[0]) > 3 or first == second:
            rule = "a delay has two paths alike but for the last station, such as 1,2 and 1,3"
            raise segment.fail("PATH_1", f"{shown} is not modelled; {rule}")
        target = paths[0][-2]
    elif len(paths[0]) > 3:
        rule = (
            "a path goes from a station over the target to a station, such as 1,2,1, or from the target: 2,1"
        )
        raise segment.fail("PATH", f"{shown} is four-way or longer, which is not modelled; {rule}")
    else:
        first, target, second = ([paths[0][0]] + paths[0])[-3:]
    one_way = len(paths[0]) == 2 and len(paths) == 1
    if target == second or (target == first and not one_way):
        raise segment.fail(wanted[0], f"{shown} has the target among the stations; correct it")
    if segment.participant(target).upper() == "UNKNOWN":
        raise segment.fail(f"PARTICIPANT_{target}", "the target is UNKNOWN; name the point on the Moon")
    sender, receiver = (
        ("" if one_way else reading.station(segment.participant(first))),
        reading.station(segment.participant(second)),
    )
    try:
        link = Link(sender, canonical_target(segment.participant(target)), receiver, len(paths) == 2)
    except InputError as error:
        raise segment.fail(f"PARTICIPANT_{target}", str(error)) from None
    return link, (first, target, second)
