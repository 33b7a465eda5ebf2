"""What all measurements of a segment share: path, time tags, delays, clocks, frequencies and weather.

Time tags are made those of the event at the station's reference point in UTC: RECEIVE_DELAY_n takes a reception back,
TRANSMIT_DELAY_n moves a transmission on, a clock's known error is taken off, and a Doppler tag goes from the
start or the end of its count interval to the middle. The delays of the stations and of the transponder are taken off
the light path.

Source: CCSDS 503.0-B-2 (2020), sections 3.3 to 3.5.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radioloc.constants import C_M_S
from radioloc.errors import FileFormatError, InputError
from radioloc.io.tdm.agreement import TdmAgreement
from radioloc.io.tdm.message import CLOCKS, LONGEST_S, RECEIVED, SENT, SENT_RATE, WEATHER
from radioloc.io.tdm.series import (
    Names,
    Placed,
    Sent,
    Series,
    clock_difference,
    frequency_sent,
    seconds_from,
    shifted_utc,
    weather_at,
)
from radioloc.measurements.link import Link
from radioloc.measurements.targets import canonical_target
from radioloc.time import Epochs

MICROMETRES = 1e6


@dataclass(slots=True)
class Shared:
    """What the segments of one reading share: what all of them say, and what has been collected of them.

    ``used`` are the segments and data keywords that observations were made of or with.
    """

    segments: list[Placed]
    agreement: TdmAgreement
    names: Names
    sent: Sent
    clocks: Mapping[tuple[str, str], Series]
    links: dict[Link, int] = field(default_factory=dict)
    columns: list[dict[str, Any]] = field(default_factory=list)
    used: set[tuple[int, str]] = field(default_factory=set)
    notes: list[str] = field(default_factory=list)


class SegmentReader:
    """One segment whose records are to become observations.

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
            removed = self.agreement.delays_removed
            self.sent = frequency_sent(
                shared.sent, pair, placed.place, path[0], band, needed=needed, delays_removed=removed
            )

    def values(self, keyword: str) -> NDArray[np.float64]:
        """Values of a keyword's records."""
        return self.segment.value[self.segment.rows(keyword)]

    def epochs(self, keyword: str) -> Epochs:
        """Time tags of a keyword's records, as the file gives them but in UTC."""
        return self.segment.epoch[self.segment.rows(keyword)]

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
        epoch = self.epochs(keyword)
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
        return shifted_utc(self.epochs(keyword), middle_s + delay_s + clock_s)

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
        epoch = self.epochs(keyword)
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
        return {"uplink_hz": uplink_hz, "wavelength_um": MICROMETRES * C_M_S / hz}

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
