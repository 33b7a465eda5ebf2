"""Reader of received frequencies (STRF), and their conversion to Doppler in metres.

With light time tau(t) at reception t, the phase that arrives at t left the transmitter at t - tau(t), multiplied by the
transponder's ratio M. Of a frequency f that is sent, the mean received frequency F over the count interval T from t0 on
obeys F T = M f [T - (tau(t0 + T) - tau(t0))]: the light path has grown by c T (1 - F / (M f)), whatever the light time
(Moyer 2003, section 13.3). An oscillator that is off by a part y of its frequency adds -c T y: the parameter
``frequency_offset`` by link and pass, or one-way ``target_frequency``.

STRF and its rffit (``.dat``): a line is the time of the middle of an integration (modified Julian date, UTC; in older
files ``yy/mm/dd hh:mm:ss.s``), the frequency of the signal's peak (Hz), its strength, which is not used, and the number
of the site. A second site is that of a transmitter whose signal the target reflects. Sites are stations called ``COSPAR
4171``, as tracking messages of the same observers call them.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePath
from typing import NamedTuple

import numpy as np

from radioloc.constants import C_M_S, MJD_ZERO_JD, SECONDS_PER_DAY
from radioloc.earth.stations import Station, StationCatalogue
from radioloc.errors import FileFormatError, InputError, in_file
from radioloc.io.checks import read_utc
from radioloc.measurements.link import Link
from radioloc.measurements.observations import Observations, without_duplicates
from radioloc.measurements.registry import KINDS
from radioloc.measurements.table_columns import unique_items
from radioloc.quantities import convert_fields
from radioloc.text_files import read_lines
from radioloc.time import Epochs
from radioloc.time.dates import utc_from_seconds_of_day
from radioloc.units import set_fields
from radioloc.vectors import Floats

MAX_DURATION_S = 86400.0
"""Upper bound of delays, count intervals, light times and clock differences, s."""
MICROMETRES = 1e6
_MAX_RANGE_RATE_M_S = 3e5
_NUMBER = r"[+-]?\d+(?:\.\d*)?(?:[eE][+-]?\d+)?"
_READING = re.compile(
    r"(?:(\d{5})(\.\d+)|(\d\d/\d\d/\d\d)\s+(\d\d:\d\d:\d\d(?:\.\d*)?))"
    r"\s+(\d{1,15}(?:\.\d*)?)\s+\S+\s+(\d{1,4})(?:\s+(\d{1,4}))?",
    re.ASCII,
)
_SITE = re.compile(rf"(\d{{1,4}})\s+\S+\s+({_NUMBER})\s+({_NUMBER})\s+({_NUMBER})(?:\s.*)?", re.ASCII)


@dataclass(frozen=True, slots=True)
class FrequencyAgreement:
    """Signal of files of received frequencies, from which Doppler follows.

    Raises
    ------
    InputError
        A value is impossible, or only one of transmitter and turnaround ratio is given.
    """

    #: Transmitted frequency, Hz: nominal frequency of the target's oscillator, or of the uplink.
    transmit_hz: float
    sigma_hz: float  #: standard deviation of a received frequency, the mean over a count interval, Hz
    count_s: float | None = None  #: count interval about the time tag, s; STRF needs it, messages state it
    target: str = "lander"  #: name of the target in the observations
    transmitter: str = ""  #: station of the uplink of a two- or three-way signal; empty for a one-way signal
    #: With a transmitter, numerator and denominator of the transponder's ratio of downlink to uplink frequency.
    turnaround: tuple[int, int] | None = None
    files: tuple[str, ...] | None = None  #: names or globs of the files; by default all

    def __post_init__(self) -> None:
        convert_fields(self)
        if isinstance(self.files, str):
            set_fields(self, files=(self.files,))
        for name in ("transmit_hz", "sigma_hz", "count_s"):
            value = getattr(self, name)
            if value is not None and not (math.isfinite(value) and value > 0.0):
                raise InputError(f"{name}: expected a finite number above zero, got {value}")
        if self.count_s is not None and self.count_s > MAX_DURATION_S:
            raise InputError(f"count_s: expected at most a day, {MAX_DURATION_S:g} s, got {self.count_s}")
        require_ratio(self.turnaround)
        if bool(self.transmitter) != (self.turnaround is not None):
            raise InputError("transmitter and turnaround belong together; give both or neither")
        Link(self.transmitter, self.target, "receiver")

    @property
    def ratio(self) -> tuple[int, int]:
        """Ratio of downlink to transmitted frequency, 1/1 for a one-way signal."""
        return self.turnaround or (1, 1)

    @property
    def received_hz(self) -> float:
        """Frequency received from a target at rest, Hz."""
        return self.transmit_hz * self.ratio[0] / self.ratio[1]


class Reading(NamedTuple):
    """Received frequency of one line of a file."""

    date: str  # UTC, of the middle of the count at reception
    second_of_day: float  # NaN if the date includes the time of day
    received_hz: float  # mean over the count
    line: int
    ends: tuple[str, str]  # transmitter, empty for that of the agreement, and receiver


def require_ratio(turnaround: tuple[int, int] | None) -> None:
    """Require two whole numbers above zero, or None."""
    is_ratio = turnaround is None or (
        len(turnaround) == 2 and all(isinstance(x, int) and x > 0 for x in turnaround)
    )
    if not is_ratio:
        raise InputError(f"turnaround = {turnaround!r}; give two whole numbers such as (880, 749)")


def agreement_for(path: str | Path, agreements: Iterable[FrequencyAgreement]) -> FrequencyAgreement | None:
    """Return the first agreement that matches a file."""
    matching = (
        a for a in agreements if a.files is None or any(PurePath(path).match(name) for name in a.files)
    )
    return next(matching, None)


def range_change_m(
    received_hz: Floats,
    offset_hz: float,
    sent_hz: float,
    ratio: tuple[int, int],
    count_s: float,
    fail: Callable[[str, int], FileFormatError],
) -> Floats:
    """Return the change of the light path over count intervals, m; an impossible speed is an error of that row."""
    up, down = ratio
    # Differences of nearly equal frequencies first, which are exact.
    part = ((up * sent_hz - down * offset_hz) - down * received_hz) / (up * sent_hz)
    wrong = ~(np.abs(part) < _MAX_RANGE_RATE_M_S / C_M_S)
    if wrong.any():
        row = int(np.argmax(wrong))
        problem = f"{float(offset_hz + received_hz[row])!r} Hz cannot be received of {sent_hz!r} Hz sent"
        advice = "correct the ratio, the offset or the frequency"
        raise fail(f"{problem}, with a turnaround of {up}/{down}; {advice}", row)
    return np.asarray(C_M_S * (count_s * part))


def _observations(
    path: str | Path,
    agreements: Sequence[FrequencyAgreement],
    catalogue: StationCatalogue | None,
    readings: Sequence[Reading],
) -> Observations:
    """Return the Doppler of the received frequencies of one file."""
    if not readings:
        raise FileFormatError(path, "has no readings; fetch it again")
    dates, second_of_day, hz, lines, stations = zip(*readings, strict=True)
    epoch = read_utc(path, dates, lines)
    if len(rows := np.flatnonzero(~np.isnan(second_of_day))):
        counted = utc_from_seconds_of_day(epoch.jd[rows], np.array(second_of_day)[rows])
        epoch.jd[rows], epoch.fraction[rows] = counted.jd, counted.fraction
    received_hz = np.array(hz)
    ends, station = unique_items(stations)
    agreement = agreement_for(path, agreements)
    if agreement is None:
        problem = "received frequencies need the transmitted one; give transmit_hz and sigma_hz under"
        raise FileFormatError(path, f"{problem} [[observations.frequencies]] (FrequencyAgreement in Python)")
    count_s = agreement.count_s
    if count_s is None:
        problem = "lacks the integration time; give count_s under [[observations.frequencies]]"
        raise FileFormatError(path, problem)
    value_m = range_change_m(
        received_hz,
        0.0,
        agreement.transmit_hz,
        agreement.ratio,
        count_s,
        lambda problem, row: FileFormatError(path, problem, lines[row]),
    )
    with in_file(path):
        names = [(up or agreement.transmitter, agreement.target, down) for up, down in ends]
        links = [Link(*participants).with_canonical_names(catalogue) for participants in names]
    one_way = np.array([not link.transmitter for link in links])[station]
    observations = Observations.from_columns(
        epoch=epoch,
        links=links,
        link=station,
        tag=1,
        kind=np.where(one_way, KINDS.index("one_way_doppler"), KINDS.index("doppler")),
        value_m=value_m,
        sigma_m=C_M_S * count_s * agreement.sigma_hz / agreement.received_hz,
        count_s=count_s,
        uplink_hz=np.where(one_way, np.nan, agreement.transmit_hz),
        wavelength_um=MICROMETRES * C_M_S / agreement.received_hz,
        files=(str(path),),
        line=lines,
    )
    return without_duplicates(observations, first_counts=True)


def looks_like_strf(lines: list[str]) -> bool:
    """Return whether the first line with content is a reading."""
    first = next(filter(None, map(_content, lines)), "")
    return _READING.fullmatch(first) is not None


def read_strf(
    path: str | Path, agreements: Sequence[FrequencyAgreement], *, catalogue: StationCatalogue | None = None
) -> Observations:
    """Read a file of received frequencies, plain or gzip, as Doppler by the first agreement that matches it."""
    readings = []
    for number, text in enumerate(read_lines(path, ended=True), start=1):
        if not (content := _content(text)):
            continue
        if (match := _READING.fullmatch(content)) is None:
            problem = (
                f"expected date (MJD), frequency (Hz), strength and number of the site, got {content[:60]!r}"
            )
            raise FileFormatError(path, problem, number)
        mjd, part, day, time, frequency, receiver, transmitter = match.groups()
        if mjd is None:
            date, second_of_day = f"20{day.replace('/', '-')}T{time}", math.nan
        else:
            date, second_of_day = _day_of(int(mjd)), SECONDS_PER_DAY * float(part)
        ends = _site_name(transmitter) if transmitter else "", _site_name(receiver)
        readings.append(Reading(date, second_of_day, float(frequency), number, ends))
    return _observations(path, agreements, catalogue, readings)


def read_sites(path: str | Path) -> tuple[Station, ...]:
    """Read a file of sites (``sites.txt``: number, initials, latitude, longitude, height, observer) as stations.

    Their coordinates, degrees with four decimals and metres above the sea, have errors of some tens of metres.

    Raises
    ------
    FileFormatError
        The file or a line of it cannot be read, which the message names, or it has no site.

    Examples
    --------
    >>> from radioloc.io import read_sites
    >>> [station.name for station in read_sites("examples/beacon/sites.txt")]
    ['COSPAR 9001', 'COSPAR 9002', 'COSPAR 9003']
    """
    stations: dict[str, Station] = {}
    for number, text in enumerate(read_lines(path), start=1):
        if not (content := _content(text)):
            continue
        if (match := _SITE.fullmatch(content)) is None:
            problem = (
                f"expected number, initials, latitude, longitude (deg), height (m), got {content[:60]!r}"
            )
            raise FileFormatError(path, problem, number)
        name, (latitude, longitude, height_m) = _site_name(match[1]), map(float, match.groups()[1:])
        with in_file(path, number):
            station = Station.from_geodetic(
                longitude_deg=longitude,
                latitude_deg=latitude,
                height_m=height_m,
                name=name,
                aliases=(),
                kind="ttc",
                epoch_year=2000.0,
                quality="rounded",
                source=Path(path).name,
            )
        if name in stations:
            raise FileFormatError(path, f"site {match[1]} is repeated; leave one of them out", number)
        stations[name] = station
    if not stations:
        raise FileFormatError(
            path, "has no site: number, initials, latitude, longitude (deg) and height (m) on a line"
        )
    return tuple(stations.values())


def _content(line: str) -> str:
    """Return a line without its comment, or an empty text for a heading, which has no digit."""
    content = line.partition("#")[0].strip()
    return content if any(map(str.isdigit, content)) else ""


def _site_name(number: str) -> str:
    return f"COSPAR {number.zfill(4)}"


def _day_of(mjd: float) -> str:
    return str(Epochs.from_jd(MJD_ZERO_JD + mjd, 0.0, "UTC").day_strings()[0])
