"""Measurements of one segment of a Tracking Data Message as columns of observations.

Time tags are made those of the event at the station's reference point in UTC: RECEIVE_DELAY_n takes a reception back,
TRANSMIT_DELAY_n moves a transmission on, a clock's known error is taken off, and a Doppler tag goes from the
start or the end of its count interval to the middle. The delays of the stations and of the transponder are taken off
the light path.

Source: CCSDS 503.0-B-2 (2020), sections 3.3 to 3.5.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radioloc.constants import C_M_S
from radioloc.errors import FileFormatError, InputError
from radioloc.io.tdm_agreement import TdmAgreement
from radioloc.io.tdm_clocks import ClockDifference, Clocks
from radioloc.io.tdm_file import TdmFile, TdmSegment
from radioloc.io.tdm_frequencies import Received, Sent, SentFrequency
from radioloc.io.tdm_keywords import CLOCKS, LONGEST_S, RANGE_RATES, RECEIVED, SENT, SENT_RATE, WEATHER
from radioloc.io.tdm_paths import Names, SignalPath, participant, signal_path
from radioloc.io.tdm_ranges import range_scale, require_convention, require_lunar, without_ambiguity
from radioloc.io.tdm_times import seconds_from, shifted_utc
from radioloc.io.tdm_weather import weather_at
from radioloc.measurements.link import Link
from radioloc.measurements.measurement_type import TIME_TAGS
from radioloc.measurements.observations import DOPPLER, RANGE, VLBI_DELAY
from radioloc.measurements.registry import KINDS
from radioloc.time import Epochs

INSTANTANEOUS_COUNT_S = 1.0
"""Count interval that stands for an instantaneous range rate, s.

Over a second the mean rate differs from the rate at its middle by a 24th of the path's third derivative, 2e-7 m/s
for a station on the turning Earth.
"""

_MICROMETRES = 1e6


@dataclass(slots=True)
class Shared:
    """What the segments of one reading share: what all of them say, and what has been collected of them.

    Parameters
    ----------
    segments : list of (TdmFile, TdmSegment)
        All segments of all messages.
    files : tuple of str
        The files they come from.
    agreement, names
        What the messages do not say; how participants are called.
    sent, clocks
        Transmitted frequencies and clocks of all segments.
    links, columns
        Links found, with their numbers, and columns of observations.
    used : set of (int, str)
        Segments and data keywords that observations were made of or with.
    notes : list of str
        What was done to values and time tags.
    """

    segments: list[tuple[TdmFile, TdmSegment]]
    files: tuple[str, ...]
    agreement: TdmAgreement
    names: Names
    sent: Sent
    clocks: Clocks
    links: dict[Link, int] = field(default_factory=dict)
    columns: list[dict[str, Any]] = field(default_factory=list)
    used: set[tuple[int, str]] = field(default_factory=set)
    notes: list[str] = field(default_factory=list)


class SegmentReader:
    """Turns the measurements of one segment into columns."""

    def __init__(self, shared: Shared, place: int, path: str, segment: TdmSegment, *, delay: bool) -> None:
        self.shared, self.place, self.path, self.segment = shared, place, path, segment
        self.agreement = shared.agreement
        self.signal: SignalPath = signal_path(path, segment, shared.names, delay=delay)
        self.ends = tuple(
            shared.names.key(participant(segment, number))
            for number in (self.signal.first, self.signal.second)
        )
        self.tag = segment.metadata.get("TIMETAG_REF", "RECEIVE").lower()
        target = shared.names.key(participant(segment, self.signal.target))
        band = segment.metadata.get("TRANSMIT_BAND", "")
        self.sent: SentFrequency | None = None
        if not delay:
            needed = bool(set(RECEIVED) & set(segment.keywords()))
            pair = (self.ends[0], target)
            self.sent = shared.sent.find(pair, band, place, self.signal.first, needed=needed)

    def fail(self, keyword: str, problem: str) -> FileFormatError:
        """Error at the first record of a data keyword, or at the line of a metadata keyword."""
        line = self.segment.line_of(keyword)
        if keyword in self.segment.keywords():
            line = int(self.segment.line[self.segment.rows(keyword)[0]])
        return FileFormatError(self.path, problem, line)

    def refuse_corrections(self, keyword: str, corrections: Sequence[str]) -> None:
        """Refuse corrections that are still to be applied to data for which there is no rule."""
        for name in corrections:
            if name in self.segment.metadata and self.segment.metadata.get("CORRECTIONS_APPLIED") == "NO":
                problem = (
                    f"{name} is not applied, and how it is to be applied to {keyword} is not said; apply it"
                )
                raise self.fail(name, problem)

    def delay_s(self, *names: str) -> float:
        """Sum of delays that are still in the data and not the model's, s."""
        if self.agreement.delays_removed:
            return 0.0
        left = [name for name in names if name in self.segment.metadata and self.is_modelled(name)]
        self.shared.notes += [f"{name} stays in the data: the model has that delay" for name in left]
        return sum(self.segment.number(name) for name in names if name not in left)

    def is_modelled(self, name: str) -> bool:
        """Whether the model has the delay of a keyword."""
        way, _, number = name.partition("_DELAY_")
        if int(number) == self.signal.target:
            return self.agreement.modelled.transponder_s is not None
        key = self.shared.names.key
        mine = key(participant(self.segment, int(number)))
        return any(
            (delay.transmit_s if way == "TRANSMIT" else delay.receive_s) is not None
            for station, delay in self.agreement.modelled.stations.items()
            if key(station) == mine
        )

    def clock_s(
        self, parts: list[tuple[float, ClockDifference]], epoch: Epochs, keyword: str
    ) -> NDArray[np.float64]:
        """Sum of differences of clocks at epochs, s."""
        total = np.zeros(len(epoch))
        for sign, difference in parts:
            value = difference.at(epoch)
            if np.isnan(value).any():
                row = int(np.argmax(np.isnan(value)))
                problem = (
                    f"{keyword} is earlier than the first CLOCK_BIAS of its station ({difference.origin})"
                )
                line = int(self.segment.line[self.segment.rows(keyword)[row]])
                raise FileFormatError(
                    self.path,
                    f"{problem}; add an earlier one, or set apply_clocks = False (in a study file "
                    "tdm_apply_clocks = false)",
                    line,
                )
            if (np.abs(value) > LONGEST_S).any():
                problem = (
                    f"CLOCK_BIAS ({difference.origin}) comes to more than a day; correct it or its drift"
                )
                raise FileFormatError(self.path, problem, self.segment.line_of(""))
            total += sign * value
            self.shared.used |= {(place, name) for place in difference.places for name in CLOCKS}
        return total

    def tagged(self, keyword: str, middle_s: float = 0.0) -> Epochs:
        """Epochs of a keyword's records at the station's reference point, moved on by ``middle_s``."""
        epoch = self.segment.epoch[self.segment.rows(keyword)]
        at_first = self.tag == "transmit" or self.signal.link.differenced
        station, number = (
            (self.ends[0], self.signal.first) if at_first else (self.ends[1], self.signal.second)
        )
        delay_s = (
            self.delay_s(f"TRANSMIT_DELAY_{number}")
            if self.tag == "transmit"
            else -self.delay_s(f"RECEIVE_DELAY_{number}")
        )
        clock_s = self.clock_s(self.shared.clocks.utc_minus(station), epoch, keyword)
        if clock_s.any() or delay_s:
            self.shared.notes.append(
                f"{self.signal.link.path}: {self.tag} time tags moved by {delay_s:.9g} s of delay"
                + (f" and by the clock of {station}" if clock_s.any() else "")
            )
        return shifted_utc(epoch, middle_s + delay_s + clock_s)

    def add_ranges(self) -> None:
        """Add RANGE."""
        signal, segment = self.signal, self.segment
        rows = segment.rows("RANGE")
        scale = range_scale(self.path, segment, self.agreement, self.sent)
        epoch = self.tagged("RANGE")
        delay_s = self.delay_s(
            f"TRANSMIT_DELAY_{signal.first}",
            f"RECEIVE_DELAY_{signal.target}",
            f"TRANSMIT_DELAY_{signal.target}",
            f"RECEIVE_DELAY_{signal.second}",
        )
        later_s = self.clock_s(self.shared.clocks.between(*self.ends), segment.epoch[rows], "RANGE")
        self.note(delay_s, later_s, scale.correction_m)
        value_m = scale.value_m * segment.value[rows]
        if scale.correction_m or delay_s or later_s.any():
            value_m = value_m + (scale.correction_m - C_M_S * (delay_s + later_s))
        light_s = self.agreement.known_light_time_s(epoch, signal.link, self.tag) if scale.modulus_m else None
        value_m = without_ambiguity(self.path, segment.line[rows], value_m, scale.modulus_m, light_s)
        if self.agreement.lunar:
            require_convention(self.path, segment.line[rows], value_m, self.agreement.range_convention)
        if self.agreement.lunar and self.shared.names.catalogue is not None:
            require_lunar(self.path, segment.line[rows], value_m)
        frequencies = {"uplink_hz": self.uplink_hz("RANGE"), "wavelength_um": self.downlink_um("RANGE")}
        self.add("RANGE", RANGE, epoch, value_m, **frequencies)

    def add_range_rates(self, keyword: str) -> None:
        """Add DOPPLER_INTEGRATED or DOPPLER_INSTANTANEOUS."""
        segment = self.segment
        rows = segment.rows(keyword)
        if len(set(segment.keywords()) & set(RANGE_RATES)) > 1:
            raise self.fail(
                keyword, "mean and instantaneous range rates of one signal; leave one of them out"
            )
        if keyword == "DOPPLER_INTEGRATED":
            count_s, middle_s = self.count_interval(keyword)
        else:
            self.require_received(keyword)
            count_s, middle_s = INSTANTANEOUS_COUNT_S, 0.0
        applied = segment.metadata.get("CORRECTIONS_APPLIED") != "NO"
        correction_m_s = 0.0 if applied else 1000.0 * segment.number("CORRECTION_DOPPLER")
        halves = 2.0 if self.agreement.doppler_convention == "half" else 1.0
        rate_m_s = segment.value[rows] + correction_m_s
        self.add(
            keyword,
            DOPPLER,
            self.tagged(keyword, middle_s),
            halves * count_s * rate_m_s,
            count_s=count_s,
            uplink_hz=self.uplink_hz(keyword),
            wavelength_um=self.downlink_um(keyword),
        )

    def add_received(self, keyword: str) -> None:
        """Add RECEIVE_FREQ or RECEIVE_FREQ_n as Doppler."""
        segment, signal = self.segment, self.signal
        rows = segment.rows(keyword)
        if keyword not in ("RECEIVE_FREQ", f"RECEIVE_FREQ_{signal.second}"):
            problem = f"{keyword} is there, but PATH ends at participant {signal.second}; correct one of them"
            raise self.fail(keyword, problem)
        count_s, middle_s = self.count_interval(keyword)
        if self.sent is None:
            problem = (
                f"needs TRANSMIT_FREQ_{signal.first} of {signal.link.transmitter}; add it, in any segment"
            )
            raise self.fail(keyword, f"{keyword} {problem}")
        turnaround = self.turnaround()
        if turnaround is None:
            problem = (
                "needs the transponder's ratio; give TURNAROUND_NUMERATOR and _DENOMINATOR, or turnaround "
                "(in a study file tdm_turnaround)"
            )
            raise self.fail(keyword, f"{keyword} {problem}")
        applied = segment.metadata.get("CORRECTIONS_APPLIED") != "NO"
        value_hz = segment.value[rows] + (0.0 if applied else segment.number("CORRECTION_RECEIVE"))
        offset_hz = segment.number("FREQ_OFFSET")
        epoch = self.tagged(keyword, middle_s)
        light_s = (
            None if self.sent.constant else self.agreement.known_light_time_s(epoch, signal.link, self.tag)
        )
        received = Received(self.path, segment.line[rows], epoch, count_s, offset_hz, value_hz)
        self.mark_sent()
        received_hz = offset_hz + value_hz
        self.add(
            keyword,
            DOPPLER,
            epoch,
            received.growth_m(self.sent, turnaround, light_s),
            count_s=count_s,
            uplink_hz=self.uplink_hz(keyword),
            wavelength_um=_MICROMETRES * C_M_S / np.where(received_hz > 0.0, received_hz, np.nan),
        )

    def add_delays(self, keyword: str) -> None:
        """Add VLBI_DELAY or DOR."""
        segment, signal = self.segment, self.signal
        rows = segment.rows(keyword)
        self.require_received(keyword)
        self.refuse_corrections(keyword, ("CORRECTION_RANGE", "CORRECTION_RECEIVE", "CORRECTION_TRANSMIT"))
        delay_s = self.delay_s(f"RECEIVE_DELAY_{signal.second}") - self.delay_s(
            f"RECEIVE_DELAY_{signal.first}"
        )
        later_s = self.clock_s(self.shared.clocks.between(*self.ends), segment.epoch[rows], keyword)
        self.note(delay_s, later_s, 0.0)
        if segment.number("RANGE_MODULUS"):
            self.shared.notes.append(
                f"{signal.link.path}: RANGE_MODULUS is that of ranges, not applied to {keyword}"
            )
        value_m = C_M_S * segment.value[rows]
        if delay_s or later_s.any():
            value_m = value_m - C_M_S * (delay_s + later_s)
        wavelength_um: Any = np.nan
        beacon = SENT[signal.target - 1]
        if len(sent := segment.value[segment.rows(beacon)]) and (sent == sent[0]).all() and sent[0] > 0.0:
            wavelength_um = _MICROMETRES * C_M_S / sent[0]
            self.shared.used.add((self.place, beacon))
        self.add(keyword, VLBI_DELAY, self.tagged(keyword), value_m, wavelength_um=wavelength_um)

    def require_received(self, keyword: str) -> None:
        """Refuse data that must be tagged at reception and are not."""
        if self.tag != "receive":
            raise self.fail(
                "TIMETAG_REF", f"TIMETAG_REF is TRANSMIT; {keyword} is modelled at its reception only"
            )

    def count_interval(self, keyword: str) -> tuple[float, float]:
        """Count interval, s, and how far its middle is after the time tag."""
        self.require_received(keyword)
        for name in ("INTEGRATION_INTERVAL", "INTEGRATION_REF"):
            if name not in self.segment.metadata:
                raise self.fail(
                    keyword, f"{keyword} needs {name}, which has no default; add it to the metadata"
                )
        count_s = self.segment.number("INTEGRATION_INTERVAL")
        part = {"START": 0.5, "MIDDLE": 0.0, "END": -0.5}[self.segment.metadata["INTEGRATION_REF"]]
        return count_s, part * count_s

    def turnaround(self) -> tuple[int, int] | None:
        """Transponder's ratio, from the file or else from the agreement."""
        given = [f"TURNAROUND_{part}" for part in ("NUMERATOR", "DENOMINATOR")]
        there = [name for name in given if name in self.segment.metadata]
        if len(there) == 1:
            raise self.fail(there[0], f"{there[0]} stands alone; give {given[0]} and {given[1]}")
        if not there:
            return self.agreement.turnaround
        return int(self.segment.number(given[0])), int(self.segment.number(given[1]))

    def uplink_hz(self, keyword: str) -> NDArray[np.float64]:
        """Transmitted frequency, of when the signal left where that is known, else at the time tags.

        NaN where it was not recorded. It serves dispersive delays only, which do not see the difference.
        """
        epoch = self.segment.epoch[self.segment.rows(keyword)]
        if self.sent is None:
            return np.full(len(epoch), np.nan)
        self.mark_sent()
        if self.tag == "receive" and not self.sent.constant:
            light_s = self.agreement.known_light_time_s(epoch, self.signal.link, self.tag)
            epoch = epoch if light_s is None else shifted_utc(epoch, -light_s)
        return self.sent.at(epoch)

    def downlink_um(self, keyword: str) -> NDArray[np.float64]:
        """Wavelength received, from a received frequency in the segment, or from what was sent."""
        epoch = self.segment.epoch[self.segment.rows(keyword)]
        received = [
            name for name in ("RECEIVE_FREQ", RECEIVED[self.signal.second]) if name in self.segment.keywords()
        ]
        if received:
            rows = self.segment.rows(received[0])
            frequency = self.segment.value[rows] + self.segment.number("FREQ_OFFSET")
            times = self.segment.epoch[rows]
            since, wanted = (seconds_from(times[[0]], utc) for utc in (times, epoch))
            place = np.searchsorted(since, wanted, side="right") - 1
            hz = np.where((place >= 0) & (frequency[place] > 0.0), frequency[place], np.nan)
            self.shared.used.add((self.place, received[0]))
        else:
            up, down = self.turnaround() or (np.nan, 1)
            hz = self.uplink_hz(keyword) * up / down
        return _MICROMETRES * C_M_S / hz

    def mark_sent(self) -> None:
        """Note that the transmitted frequency was of use."""
        if self.sent is not None:
            self.shared.used |= {(place, name) for place in self.sent.places for name in (*SENT, *SENT_RATE)}

    def note(self, delay_s: float, later_s: NDArray[np.float64], correction_m: float) -> None:
        """Say what was taken off or added to values."""
        path = self.signal.link.path
        if delay_s:
            self.shared.notes.append(f"{path}: {delay_s:.9g} s of delay in equipment taken off")
        if later_s.any():
            self.shared.notes.append(f"{path}: clock difference of {later_s[0]:.6g} s taken off")
        if correction_m:
            self.shared.notes.append(f"{path}: correction of {correction_m:.9g} m added")

    def weather(self, epoch: Epochs) -> dict[str, NDArray[np.float64]]:
        """Weather columns at the epochs, where some belongs to the observations."""
        if set(WEATHER) & set(self.segment.keywords()):
            places = [self.place]
        elif self.ends[0] == self.ends[1]:
            places = [
                place
                for place, (_, other) in enumerate(self.shared.segments)
                if set(WEATHER) & set(other.keywords())
                and "PATH" not in other.metadata
                and "PARTICIPANT_1" in other.metadata
                and self.shared.names.key(participant(other, 1)) == self.ends[0]
            ]
        else:
            return {}
        self.shared.used |= {(place, name) for place in places for name in WEATHER}
        return weather_at([self.shared.segments[place][1] for place in places], epoch)

    def sigma_m(self, keyword: str, kind: str) -> float:
        """Agreed standard deviation of a kind of observation, m."""
        try:
            return self.agreement.sigma_of(kind)
        except InputError as error:
            raise self.fail(keyword, str(error)) from None

    def add(self, keyword: str, kind: int, epoch: Epochs, value_m: NDArray[np.float64], **more: Any) -> None:
        """Add rows for all records of a keyword."""
        rows = self.segment.rows(keyword)
        n = len(rows)
        weather = self.weather(self.segment.epoch[rows])
        columns: dict[str, Any] = {"uplink_hz": np.nan, "wavelength_um": np.nan, "count_s": np.nan} | more
        for name in ("pressure_hpa", "temperature_k", "relative_humidity"):
            columns[name] = weather.get(name, np.nan)
        columns |= {
            "value_m": value_m,
            "sigma_m": self.sigma_m(keyword, KINDS[kind]),
            "kind": kind,
            "tag": TIME_TAGS.index(self.tag),
            "link": self.shared.links.setdefault(self.signal.link, len(self.shared.links)),
            "file": self.shared.files.index(self.path),
            "line": self.segment.line[rows],
        }
        self.shared.columns.append(
            {"epoch": epoch} | {name: np.broadcast_to(value, (n,)) for name, value in columns.items()}
        )
