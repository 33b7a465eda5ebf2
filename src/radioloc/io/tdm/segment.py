"""Measurements of one segment of a Tracking Data Message as columns of observations.

Time tags are made those of the event at the station's reference point in UTC: RECEIVE_DELAY_n takes a reception back,
TRANSMIT_DELAY_n moves a transmission on, a clock's known error is taken off, and a Doppler tag goes from the
start or the end of its count interval to the middle. The delays of the stations and of the transponder are taken off
the light path. A range is taken at its time tag: INTEGRATION_INTERVAL is the count interval of Doppler.

With light time tau(t) at reception t, the phase that arrives at t left the transmitter at t - tau(t), multiplied by the
transponder's ratio M. The mean received frequency F over the count interval T from t0 on then obeys (Moyer 2003,
section 13.3)

    F T = M [phase(t0 + T - tau(t0 + T)) - phase(t0 - tau(t0))],

and what is wanted is D = tau(t0 + T) - tau(t0). With a constant frequency f sent this gives D = T (1 - F / (M f))
exactly, whatever the light time. With one that changes, the light time decides which part of the ramp was received; it
must be known beforehand, but coarsely: an error e in it makes one of T e f'/f in D (a ramp of 1 Hz/s at 7 GHz, 10
microseconds and 60 s: 0.03 mm).

Source: CCSDS 503.0-B-2 (2020), sections 3.3 to 3.5.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radioloc.constants import C_M_S
from radioloc.errors import FileFormatError, InputError
from radioloc.io.checks import FLIGHT_TIME_LIMITS_S, require_lunar_flight_time
from radioloc.io.tdm.agreement import TdmAgreement
from radioloc.io.tdm.message import (
    CLOCKS,
    LONGEST_S,
    NOT_MODELLED,
    RANGE_RATES,
    RECEIVED,
    SENT,
    SENT_RATE,
    TYPES,
    WEATHER,
    exponent_of,
)
from radioloc.io.tdm.series import (
    Names,
    Placed,
    SentFrequencies,
    Series,
    clock_difference,
    seconds_from,
    shifted_utc,
    weather_at,
)
from radioloc.measurements.link import Link
from radioloc.measurements.measurement_type import TIME_TAGS
from radioloc.measurements.registry import KINDS, MEASUREMENTS
from radioloc.measurements.targets import canonical_target
from radioloc.time import Epochs

INSTANTANEOUS_COUNT_S = 1.0
"""Count interval that stands for an instantaneous range rate, s.

Over a second the mean rate differs from the rate at its middle by a 24th of the path's third derivative, 2e-7 m/s
for a station on the turning Earth.
"""
_MICROMETRES = 1e6
# A light time that is off by more than this part of the modulus does not settle the number of cycles.
_CLEAR_PART = 0.25
# The uplink differs from its first frequency by 1e-5 of it at most: each round gains five digits of 16.
_ROUNDS = 4
_FASTEST_M_S = 3e5


@dataclass(slots=True)
class Shared:
    """What the segments of one reading share: what all of them say, and what has been collected of them.

    ``used`` are the segments and data keywords that observations were made of or with.
    """

    segments: list[Placed]
    agreement: TdmAgreement
    names: Names
    sent: SentFrequencies
    clocks: Mapping[tuple[str, str], Series]
    links: dict[Link, int] = field(default_factory=dict)
    columns: list[dict[str, Any]] = field(default_factory=list)
    used: set[tuple[int, str]] = field(default_factory=set)
    notes: list[str] = field(default_factory=list)


class SegmentReader:
    """Turns the measurements of one segment into columns of observations.

    ``sender``, ``target`` and ``receiver`` are numbers of participants; of a delay the first station, the target and
    the second station. On a one-way path the target is the sender.
    """

    def __init__(self, shared: Shared, placed: Placed) -> None:
        self.shared, self.placed, self.segment = shared, placed, placed.segment
        self.agreement, self.fail = shared.agreement, placed.fail
        self.link, (self.sender, self.target, self.receiver) = _link(placed, shared.names)
        self.one_way = self.sender == self.target
        self.key = [shared.names.key(placed.participant(n)) for n in (self.sender, self.receiver)]
        self.tag = self.segment.metadata.get("TIMETAG_REF", "RECEIVE").lower()
        self.sent: Series | None = None
        if not self.link.differenced:
            path = placed.path()
            pair = (self.key[0], shared.names.key(placed.participant(path[1])))
            band = self.segment.metadata.get("TRANSMIT_BAND", "")
            needed = bool(set(RECEIVED) & set(self.segment.counts()))
            self.sent = shared.sent.find(pair, band, placed.place, path[0], needed=needed)

    def read(self, keyword: str) -> None:
        """Add the observations that a keyword's records are."""
        if keyword in NOT_MODELLED:
            problem = "is not modelled; convert it to RECEIVE_FREQ or leave it out"
            raise self.fail(keyword, f"{keyword} {problem}")
        held = {k: t for k, t in TYPES.items() if MEASUREMENTS[k].form == self.link.form}
        kind = next((kind for kind, type_ in held.items() if keyword in type_.keywords), None)
        if kind is None:
            mode = self.segment.metadata["MODE"]
            known = ", ".join(dict.fromkeys(k for type_ in held.values() for k in type_.keywords[:2]))
            raise self.fail(
                keyword, f"{keyword} of MODE = {mode} is not modelled; on its path can be {known}"
            )
        if self.tag not in TYPES[kind].tags:
            problem = f"TIMETAG_REF is {self.tag.upper()}; {keyword} is modelled at its reception only"
            raise self.fail("TIMETAG_REF", problem)
        if kind not in self.agreement.sigma_m:
            raise self.fail(
                keyword,
                f"a TDM says nothing of uncertainties, and it holds {kind} observations: "
                f"give sigma_m = {{{kind!r}: ...}} (in a study file sigma_m = {{ {kind} = ... }}, "
                f"to radioloc convert --sigma {kind}=...), in metres",
            )
        reading: Callable[[str], dict[str, Any]] = {
            "RANGE": self.ranges,
            "DOPPLER_INTEGRATED": self.range_rates,
            "DOPPLER_INSTANTANEOUS": self.range_rates,
            "VLBI_DELAY": self.delays,
            "DOR": self.delays,
        }.get(keyword, self.received)
        rows = self.segment.rows(keyword)
        columns: dict[str, Any] = dict.fromkeys(
            ("uplink_hz", "wavelength_um", "count_s", *WEATHER.values()), np.nan
        )
        columns |= self.weather(self.segment.epoch[rows]) | reading(keyword)
        columns |= {
            "sigma_m": float(self.agreement.sigma_m[kind]),
            "kind": KINDS.index(kind),
            "tag": TIME_TAGS.index(self.tag),
            "link": self.shared.links.setdefault(self.link, len(self.shared.links)),
            "line": self.segment.line[rows],
        }
        epoch, path = columns.pop("epoch"), self.placed.file.path
        self.shared.columns.append(
            {"epoch": epoch, "path": path}
            | {name: np.broadcast_to(column, (len(rows),)) for name, column in columns.items()}
        )

    # Measurements

    def ranges(self, keyword: str) -> dict[str, Any]:
        """RANGE: light path there and back, or from the target."""
        epoch = self.tagged(keyword)
        units = self.segment.metadata.get("RANGE_UNITS", "km")
        unit_m = self.range_unit_m(units)
        factor = unit_m * 10.0 ** exponent_of(keyword, units)
        modulus_m = self.segment.number("RANGE_MODULUS") * factor
        correction_m = self.segment.correction("RANGE") * factor
        ends = [("TRANSMIT", self.sender), ("RECEIVE", self.receiver)]
        if not self.one_way:
            ends[1:1] = [("RECEIVE", self.target), ("TRANSMIT", self.target)]
        delay_s = self.delay_s(*(f"{way}_DELAY_{n}" for way, n in ends))
        value_m = unit_m * self.segment.value[self.segment.rows(keyword)]
        value_m = self.less_delays(keyword, value_m, delay_s, correction_m)
        if modulus_m:
            value_m = self.without_ambiguity(value_m, modulus_m, self.light_time_s(epoch))
        self.require_plausible(value_m)
        return {"epoch": epoch, "value_m": value_m} | self.frequencies(keyword)

    def range_unit_m(self, units: str) -> float:
        """Metres of light path in one of the units that RANGE is in (m where it is km in the file)."""
        mode = self.segment.metadata.get("RANGE_MODE", "")
        if mode and (mode == "ONE_WAY") != self.one_way:
            goes = "from the target to a station" if self.one_way else "to the target and back"
            raise self.fail("RANGE_MODE", f"RANGE_MODE is {mode}, but PATH goes {goes}; correct one of them")
        if units == "RU" and self.agreement.range_unit_s is None:
            problem = "RANGE_UNITS is RU, whose length is an agreement between the agencies"
            raise self.fail("RANGE_UNITS", f"{problem}; give range_unit_s (in a study file tdm_range_unit_s)")
        if units == "RU" and self.sent is not None and not self.sent.constant:
            problem = (
                "RANGE_UNITS is RU and the transmitted frequency changes, so that the unit has no one length"
            )
            raise self.fail("RANGE_UNITS", f"{problem}; convert the ranges to km or s")
        halves = 2.0 if self.agreement.range_convention == "half" and not self.one_way else 1.0
        return halves * {"km": 1.0, "s": C_M_S, "RU": C_M_S * (self.agreement.range_unit_s or 0.0)}[units]

    def without_ambiguity(
        self, value_m: NDArray[np.float64], modulus_m: float, light_s: NDArray[np.float64] | None
    ) -> NDArray[np.float64]:
        """Light path from what is known of it but for multiples of the modulus, m, shape (n,).

        Where the modulus is longer than any path between Earth and Moon, the value stands. Else the multiple is the
        one that comes nearest to the light time known beforehand, which must be good to a quarter of the modulus.
        """
        if light_s is None:
            if modulus_m >= C_M_S * FLIGHT_TIME_LIMITS_S[1]:
                return value_m
            problem = f"RANGE_MODULUS is {modulus_m:.6g} m of light path, so that the range is known but for multiples"
            good_s = f"{_CLEAR_PART * modulus_m / C_M_S:.3g} s"
            raise self.fail("RANGE", f"{problem} of it; give light_time_s, good to {good_s}")
        known_m = C_M_S * light_s
        whole_m = value_m + modulus_m * np.rint((known_m - value_m) / modulus_m)
        off_m = np.abs(whole_m - known_m)
        if (off_m > _CLEAR_PART * modulus_m).any():
            row = int(np.argmax(off_m > _CLEAR_PART * modulus_m))
            problem = (
                f"the light time given is {off_m[row]:.6g} m from the nearest range that RANGE_MODULUS allows, "
                f"more than a quarter of the modulus ({modulus_m:.6g} m); give a better one"
            )
            raise self.fail("RANGE", problem, row)
        return whole_m

    def require_plausible(self, value_m: NDArray[np.float64]) -> None:
        """Refuse ranges that cannot be between Earth and Moon, above all those of the other convention."""
        if not self.agreement.lunar:
            return
        low_m, high_m = (C_M_S * limit * (0.5 if self.one_way else 1.0) for limit in FLIGHT_TIME_LIMITS_S)
        fits = (value_m > low_m) & (value_m < high_m)
        convention = self.agreement.range_convention
        factor, other = (2.0, "half") if convention == "round_trip" else (0.5, "round_trip")
        other_fits = (factor * value_m > low_m) & (factor * value_m < high_m) & ~fits
        if other_fits.any() and not self.one_way:
            row = int(np.argmax(other_fits))
            problem = (
                f"RANGE gives a light path of {value_m[row] / 1000.0:.6g} km, taken as {convention!r}; between Earth "
                f"and Moon there and back it is {low_m / 1000.0:.6g} to {high_m / 1000.0:.6g} km, off by a factor of "
                f'two: set tdm_range = "{other}"'
            )
            raise self.fail("RANGE", problem, row)
        if self.shared.names.catalogue is None or fits.all():
            return
        row = int(np.argmin(fits))
        if not self.one_way:
            line = self.segment.line_of("RANGE", row)
            require_lunar_flight_time(self.placed.file.path, line, float(value_m[row]) / C_M_S)
        limits = f"{low_m / 1000.0:.6g} to {high_m / 1000.0:.6g} km"
        problem = (
            f"RANGE is {value_m[row] / 1000.0:.6g} km one way, but between Earth and Moon it is {limits}"
        )
        raise self.fail("RANGE", f"{problem}; correct it or leave it out", row)

    def range_rates(self, keyword: str) -> dict[str, Any]:
        """DOPPLER_INTEGRATED or DOPPLER_INSTANTANEOUS: mean rate of the light path."""
        if len(set(self.segment.counts()) & set(RANGE_RATES)) > 1:
            problem = "mean and instantaneous range rates of one signal; leave one of them out"
            raise self.fail(keyword, problem)
        integrated = keyword == "DOPPLER_INTEGRATED"
        count_s, middle_s = self.count_interval(keyword) if integrated else (INSTANTANEOUS_COUNT_S, 0.0)
        halves = 2.0 if self.agreement.doppler_convention == "half" and not self.one_way else 1.0
        rate_m_s = self.segment.value[self.segment.rows(keyword)] + 1000.0 * self.segment.correction(
            "DOPPLER"
        )
        return {
            "epoch": self.tagged(keyword, middle_s),
            "value_m": halves * count_s * rate_m_s,
            "count_s": count_s,
        } | self.frequencies(keyword)

    def received(self, keyword: str) -> dict[str, Any]:
        """RECEIVE_FREQ or RECEIVE_FREQ_n: mean received frequency."""
        if keyword not in ("RECEIVE_FREQ", f"RECEIVE_FREQ_{self.receiver}"):
            problem = f"is there, but PATH ends at participant {self.receiver}; correct one of them"
            raise self.fail(keyword, f"{keyword} {problem}")
        count_s, middle_s = self.count_interval(keyword)
        if self.sent is None:
            sender = self.placed.participant(self.sender)
            problem = f"{keyword} needs TRANSMIT_FREQ_{self.sender} of {sender}; add it, in any segment"
            raise self.fail(keyword, problem)
        ratio = self.turnaround()
        if ratio is None:
            problem = (
                "needs the transponder's ratio; give TURNAROUND_NUMERATOR and _DENOMINATOR, or turnaround"
            )
            raise self.fail(keyword, f"{keyword} {problem} (in a study file tdm_turnaround)")
        epoch = self.tagged(keyword, middle_s)
        offset_hz = self.segment.number("FREQ_OFFSET")
        value_hz = self.segment.value[self.segment.rows(keyword)] + self.segment.correction("RECEIVE")
        value_m = self.range_difference_m(keyword, epoch, count_s, offset_hz, value_hz, self.sent, ratio)
        received_hz = offset_hz + value_hz
        wavelength_um = _MICROMETRES * C_M_S / np.where(received_hz > 0.0, received_hz, np.nan)
        return (
            {"epoch": epoch, "value_m": value_m, "count_s": count_s}
            | self.frequencies(keyword)
            | {"wavelength_um": wavelength_um}
        )

    def range_difference_m(
        self,
        keyword: str,
        middle: Epochs,
        count_s: float,
        offset_hz: float,
        value_hz: NDArray[np.float64],
        sent: Series,
        ratio: tuple[int, int],
    ) -> NDArray[np.float64]:
        """Growth of the light path over the count interval from mean received frequencies, m, shape (n,)."""
        (up, down), base_hz = ratio, float(sent.value[0])
        # Differences of nearly equal frequencies first: the digits that cancel are then gone without loss.
        growth_s = count_s * (((up * base_hz - down * offset_hz) - down * value_hz) / (up * base_hz))
        if not sent.constant:
            light_s = self.light_time_s(middle)
            if light_s is None:
                problem = "the transmitted frequency changes: which part of it was received depends on the light time"
                raise self.fail(keyword, f"{problem}; give light_time_s, to some microseconds")
            since, ramped_s = seconds_from(sent.start, middle), growth_s
            for _ in range(_ROUNDS):
                left = since - 0.5 * count_s - (light_s - 0.5 * growth_s)
                growth_s = ramped_s + sent.excess(left, left + count_s - growth_s) / base_hz
            if np.isnan(growth_s).any():
                problem = "was sent before the first TRANSMIT_FREQ; add earlier ones or leave the record out"
                raise self.fail(keyword, f"what was received {problem}", int(np.argmax(np.isnan(growth_s))))
        growth_m = C_M_S * growth_s
        fast = np.abs(growth_m) > _FASTEST_M_S * count_s
        if fast.any():
            row = int(np.argmax(fast))
            problem = (
                f"the received frequency makes the path grow by {growth_m[row] / count_s:.6g} m/s, with a turnaround "
                f"of {up}/{down} and {base_hz!r} Hz sent; correct the ratio, the offset or the frequency"
            )
            raise self.fail(keyword, problem, row)
        return growth_m

    def delays(self, keyword: str) -> dict[str, Any]:
        """VLBI_DELAY or DOR: arrival at the second station less that at the first."""
        for name in ("CORRECTION_RANGE", "CORRECTION_RECEIVE", "CORRECTION_TRANSMIT"):
            if name in self.segment.metadata and self.segment.metadata.get("CORRECTIONS_APPLIED") == "NO":
                problem = f"is not applied, and how it is to be applied to {keyword} is not said; apply it"
                raise self.fail(name, f"{name} {problem}")
        second_s, first_s = (self.delay_s(f"RECEIVE_DELAY_{n}") for n in (self.receiver, self.sender))
        value_m = C_M_S * self.segment.value[self.segment.rows(keyword)]
        value_m = self.less_delays(keyword, value_m, second_s - first_s)
        if self.segment.number("RANGE_MODULUS"):
            problem = f"RANGE_MODULUS is that of ranges, not applied to {keyword}"
            self.shared.notes.append(f"{self.link.path}: {problem}")
        wavelength_um, beacon = np.nan, SENT[self.target - 1]
        if (
            len(sent := self.segment.value[self.segment.rows(beacon)])
            and (sent == sent[0]).all()
            and sent[0] > 0.0
        ):
            wavelength_um = _MICROMETRES * C_M_S / sent[0]
            self.shared.used.add((self.placed.place, beacon))
        return {"epoch": self.tagged(keyword), "value_m": value_m, "wavelength_um": wavelength_um}

    # What measurements have in common

    def less_delays(
        self, keyword: str, value_m: NDArray[np.float64], delay_s: float, correction_m: float = 0.0
    ) -> NDArray[np.float64]:
        """Values without delays in equipment and the difference of the clocks at the ends, and with a correction."""
        parts = clock_difference(self.shared.clocks, *self.key)
        clock_s = self.clock_s(parts, keyword)
        notes = {
            f"{delay_s:.9g} s of delay in equipment taken off": delay_s,
            f"clock difference of {clock_s[0]:.6g} s taken off": clock_s.any(),
            f"correction of {correction_m:.9g} m added": correction_m,
        }
        done = [note for note, is_so in notes.items() if is_so]
        self.shared.notes += [f"{self.link.path}: {note}" for note in done]
        return value_m + (correction_m - C_M_S * (delay_s + clock_s)) if done else value_m

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
        modelled, key = self.agreement.modelled, self.shared.names.key
        if int(number) == self.target:
            return modelled.transponder_s is not None and not self.one_way
        mine = key(self.placed.participant(int(number)))
        delays = [delay for station, delay in modelled.stations.items() if key(station) == mine]
        return any(getattr(delay, f"{way.lower()}_s") is not None for delay in delays)

    def clock_s(self, parts: list[tuple[float, Series]], keyword: str) -> NDArray[np.float64]:
        """Sum of differences of clocks at a keyword's epochs, s."""
        epoch = self.segment.epoch[self.segment.rows(keyword)]
        total = np.zeros(len(epoch))
        for sign, difference in parts:
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
            self.shared.used |= {(place, name) for place in difference.places for name in CLOCKS}
        return total

    def tagged(self, keyword: str, middle_s: float = 0.0) -> Epochs:
        """Epochs of a keyword's records at the station's reference point, moved on by ``middle_s``."""
        at_first = self.tag == "transmit" or self.link.differenced
        station, number = (self.key[0], self.sender) if at_first else (self.key[1], self.receiver)
        sign, way = (1.0, "TRANSMIT") if self.tag == "transmit" else (-1.0, "RECEIVE")
        delay_s = sign * self.delay_s(f"{way}_DELAY_{number}")
        clock_s = self.clock_s(clock_difference(self.shared.clocks, station), keyword)
        if clock_s.any() or delay_s:
            of_clock = f" and by the clock of {station}" if clock_s.any() else ""
            self.shared.notes.append(
                f"{self.link.path}: {self.tag} time tags moved by {delay_s:.9g} s of delay{of_clock}"
            )
        return shifted_utc(self.segment.epoch[self.segment.rows(keyword)], middle_s + delay_s + clock_s)

    def count_interval(self, keyword: str) -> tuple[float, float]:
        """Count interval, s, and how far its middle is after the time tag."""
        for name in ("INTEGRATION_INTERVAL", "INTEGRATION_REF"):
            if name not in self.segment.metadata:
                problem = f"{keyword} needs {name}, which has no default; add it to the metadata"
                raise self.fail(keyword, problem)
        count_s = self.segment.number("INTEGRATION_INTERVAL")
        part = {"START": 0.5, "MIDDLE": 0.0, "END": -0.5}[self.segment.metadata["INTEGRATION_REF"]]
        return count_s, part * count_s

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

    def light_time_s(self, epoch: Epochs) -> NDArray[np.float64] | None:
        """Light times known beforehand, s; None where nothing was given."""
        return self.agreement.known_light_time_s(epoch, self.link, self.tag)

    def frequencies(self, keyword: str) -> dict[str, Any]:
        """Frequency sent up and wavelength received, NaN where not recorded.

        The frequency is that of when the signal left where this is known, else that at the time tags: it serves
        dispersive delays only, which do not see the difference. The wavelength is that of a received frequency in the
        segment, or of what was sent.
        """
        epoch = self.segment.epoch[self.segment.rows(keyword)]
        sent_hz = np.full(len(epoch), np.nan)
        if self.sent is not None:
            self.shared.used |= {(place, name) for place in self.sent.places for name in (*SENT, *SENT_RATE)}
            light_s = None
            if self.tag == "receive" and not self.sent.constant:
                light_s = self.light_time_s(epoch)
            sent_hz = self.sent.at(epoch if light_s is None else shifted_utc(epoch, -light_s))
        received = [k for k in ("RECEIVE_FREQ", RECEIVED[self.receiver]) if k in self.segment.counts()]
        if received:
            rows = self.segment.rows(received[0])
            frequency = self.segment.value[rows] + self.segment.number("FREQ_OFFSET")
            times = self.segment.epoch[rows]
            since, wanted = (seconds_from(times[[0]], utc) for utc in (times, epoch))
            place = np.searchsorted(since, wanted, side="right") - 1
            hz = np.where((place >= 0) & (frequency[place] > 0.0), frequency[place], np.nan)
            self.shared.used.add((self.placed.place, received[0]))
        else:
            up, down = self.turnaround() or (np.nan, 1)
            hz = sent_hz * up / down
        uplink_hz = np.nan if self.one_way else sent_hz
        return {"uplink_hz": uplink_hz, "wavelength_um": _MICROMETRES * C_M_S / hz}

    def weather(self, epoch: Epochs) -> dict[str, Any]:
        """Weather columns at the epochs, where some belongs to the observations.

        That of the segment itself; else that of segments of one participant without a path (3.3.2.7) belongs to that
        station's observations, but for those of two stations: they have only one weather.
        """
        places = [self.placed] if set(WEATHER) & set(self.segment.counts()) else []
        if not places and (self.one_way or self.key[0] == self.key[1]):
            places = [
                other
                for other in self.shared.segments
                if set(WEATHER) & set(other.segment.counts())
                and "PATH" not in other.segment.metadata
                and "PARTICIPANT_1" in other.segment.metadata
                and self.shared.names.key(other.participant(1)) == self.key[1]
            ]
        self.shared.used |= {(other.place, name) for other in places for name in WEATHER}
        return weather_at([other.segment for other in places], epoch)


def _link(placed: Placed, names: Names) -> tuple[Link, tuple[int, int, int]]:
    """Who sends, answers and receives, by a segment's MODE, paths and participants; and their numbers.

    Modelled are paths from a station over the target to a station, from the target to a station, and (MODE =
    SINGLE_DIFF) the difference of two paths that are the same but for their last station.
    """
    segment = placed.segment
    mode = segment.metadata.get("MODE")
    if mode is None:
        problem = "the metadata have no MODE, which the data need; add MODE = SEQUENTIAL or SINGLE_DIFF"
        raise placed.fail("", problem)
    wanted = ("PATH",) if mode == "SEQUENTIAL" else ("PATH_1", "PATH_2")
    for keyword in wanted:
        if keyword not in segment.metadata:
            raise placed.fail("MODE", f"MODE is {mode}, but there is no {keyword}; add it")
    paths = [placed.path(keyword) for keyword in wanted]
    shown = " and ".join(f"{keyword} = {segment.metadata[keyword]}" for keyword in wanted)
    if len(paths) == 2:
        first, second = paths[0][-1], paths[1][-1]
        if paths[0][:-1] != paths[1][:-1] or len(paths[0]) > 3 or first == second:
            rule = "a delay has two paths alike but for the last station, such as 1,2 and 1,3"
            raise placed.fail("PATH_1", f"{shown} is not modelled; {rule}")
        target = paths[0][-2]
    elif len(paths[0]) > 3:
        rule = (
            "a path goes from a station over the target to a station, such as 1,2,1, or from the target: 2,1"
        )
        raise placed.fail("PATH", f"{shown} is four-way or longer, which is not modelled; {rule}")
    else:
        first, target, second = ([paths[0][0]] + paths[0])[-3:]
    one_way = len(paths[0]) == 2 and len(paths) == 1
    if target == second or (target == first and not one_way):
        raise placed.fail(wanted[0], f"{shown} has the target among the stations; correct it")
    if placed.participant(target).upper() == "UNKNOWN":
        problem = "the target is UNKNOWN; name the point on the Moon"
        raise placed.fail(f"PARTICIPANT_{target}", problem)
    try:
        sender = "" if one_way else names.station(placed, first)
        name = canonical_target(placed.participant(target))
        link = Link(sender, name, names.station(placed, second), len(paths) == 2)
    except FileFormatError:
        raise
    except InputError as error:
        raise placed.fail(f"PARTICIPANT_{target}", str(error)) from None
    if link.differenced and link.transmitter == link.receiver:
        raise placed.fail("PATH_2", f"{shown} end at one station, {link.receiver}; a delay needs two")
    return link, (first, target, second)
