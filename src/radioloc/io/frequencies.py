"""Readers of received frequencies (STRF, Fdets), and their conversion to Doppler in metres.

With light time tau(t) at reception t, the phase that arrives at t left the transmitter at t - tau(t), multiplied by the
transponder's ratio M. Of a frequency f that is sent, the mean received frequency F over the count interval T from t0 on
obeys F T = M f [T - (tau(t0 + T) - tau(t0))]: the light path has grown by c T (1 - F / (M f)), whatever the light time
(Moyer 2003, section 13.3). An oscillator that is off by a part y of its frequency adds -c T y: the parameter
``frequency_offset`` by link and pass, or one-way ``target_frequency``.

STRF and its rffit (``.dat``): a line is the time of the middle of an integration (modified Julian date, UTC; in older
files ``yy/mm/dd hh:mm:ss.s``), the frequency of the signal's peak (Hz), its strength, which is not used, and the number
of the site. A second site is that of a transmitter whose signal the target reflects. Sites are stations called ``COSPAR
4171``, as tracking messages of the same observers call them.

Fdets, the detections of radio telescopes (PRIDE): comments at the start say the day, the telescope, the base frequency
(MHz) and, in newer files, the integration time (dT). A record is the time (UTC date, or second of the day) of the
middle of the integration, signal to noise, spectral maximum, the frequency above the base (Hz) and its residual after a
fit (Hz); a scan number, or the day as a modified Julian date, may precede the time. Molera Calves et al. (2021), PASA
38, e065.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
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
_COMMENT = ("#", "//", "*")
_HEAD = {
    "base": re.compile(r"base frequency:\s*(\S+)\s*MHz", re.IGNORECASE),
    "day": re.compile(r"conducted on (\d{4})[.-](\d\d)[.-](\d\d)(?: at (\w+))?", re.IGNORECASE | re.ASCII),
    "dT": re.compile(r"\bdT:\s*(\d+(?:\.\d*)?)\s*s", re.ASCII),
    "by_day": re.compile(r"format\s*:\s*(modified|mjd)", re.IGNORECASE),
}
_IN_NAME = re.compile(r"Fdets\.[^.]+\.\d\d\.\d\d[^.]*\.(\w+)\.")


@dataclass(frozen=True, slots=True)
class FrequencyAgreement:
    """Signal of files of received frequencies, from which Doppler follows.

    Parameters
    ----------
    transmit_hz : float or Quantity
        Transmitted frequency, Hz: nominal frequency of the target's oscillator, or of the uplink.
    sigma_hz : float or Quantity
        Standard deviation of a received frequency, the mean over a count interval, Hz.
    count_s : float or Quantity, optional
        Count interval about the time tag, s, unless the file states it.
    target : str
        Name of the target in the observations.
    transmitter : str
        Station of the uplink of a two- or three-way signal; empty for a one-way signal.
    turnaround : tuple of int, optional
        With a transmitter, numerator and denominator of the transponder's ratio of downlink to uplink frequency.
    files : str or iterable of str, optional
        Names or globs of the files; by default all.

    Raises
    ------
    InputError
        A value is impossible, or only one of transmitter and turnaround ratio is given.
    """

    transmit_hz: float
    sigma_hz: float
    count_s: float | None = None
    target: str = "lander"
    transmitter: str = ""
    turnaround: tuple[int, int] | None = None
    files: tuple[str, ...] | None = None

    def __post_init__(self) -> None:
        convert_fields(self)
        if isinstance(self.files, str):
            object.__setattr__(self, "files", (self.files,))
        for name in ("transmit_hz", "sigma_hz", "count_s"):
            value = getattr(self, name)
            if value is not None and not (math.isfinite(value) and value > 0.0):
                raise InputError(f"{name} = {value}, but must be finite and above zero")
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


def agreement_on(path: str | Path, agreements: Iterable[FrequencyAgreement]) -> FrequencyAgreement | None:
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


def frequency_observations(
    path: str | Path,
    agreements: Sequence[FrequencyAgreement],
    catalogue: StationCatalogue | None,
    readings: Sequence[Reading],
    *,
    offset_hz: float = 0.0,
    count_s: float | None = None,
) -> Observations:
    """Return the Doppler of the received frequencies of one file, whose `offset_hz` and count interval it may state."""
    if not readings:
        raise FileFormatError(path, "has no readings; fetch it again")
    dates, second_of_day, hz, lines, stations = zip(*readings, strict=True)
    epoch = read_utc(path, dates, lines)
    if len(rows := np.flatnonzero(~np.isnan(second_of_day))):
        counted = utc_from_seconds_of_day(epoch.jd[rows], np.array(second_of_day)[rows])
        epoch.jd[rows], epoch.fraction[rows] = counted.jd, counted.fraction
    received_hz = np.array(hz)
    ends, station = unique_items(stations)
    agreement = agreement_on(path, agreements)
    if agreement is None:
        problem = "received frequencies need the transmitted one; give transmit_hz and sigma_hz under"
        raise FileFormatError(path, f"{problem} [[observations.frequencies]] (FrequencyAgreement in Python)")
    count_s = agreement.count_s or count_s
    if count_s is None:
        problem = "lacks the integration time; give count_s under [[observations.frequencies]]"
        raise FileFormatError(path, problem)
    value_m = range_change_m(
        received_hz,
        offset_hz,
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
    return frequency_observations(path, agreements, catalogue, readings)


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


def looks_like_fdets(lines: list[str]) -> bool:
    """Return whether the comments at the start of a file state a base frequency."""
    head = [line for line in lines[:10] if line.lstrip().startswith(_COMMENT)]
    return bool(head) and head[0] == lines[0] and any(_HEAD["base"].search(line) for line in head)


def read_fdets(
    path: str | Path, agreements: Sequence[FrequencyAgreement], *, catalogue: StationCatalogue | None = None
) -> Observations:
    """Read a file of frequency detections, plain or gzip, as Doppler; the file or its name states the telescope."""
    head: dict[str, re.Match[str]] = {}
    detections = []
    for number, text in enumerate(read_lines(path, ended=True), start=1):
        if not (content := text.strip()) or content.startswith(_COMMENT):
            for name, form in _HEAD.items():
                if name not in head and (match := form.search(content)):
                    head[name] = match
            continue
        try:
            *scan, time, _, _, frequency_hz, _ = content.split()
            if len(scan) > 1:
                raise ValueError
            epoch = _date_and_second(path, number, time, scan, head)
            detections.append((*epoch, float(frequency_hz), number))
        except FileFormatError:
            raise
        except ValueError:
            problem = f"expected time, signal to noise, maximum, frequency and residual, got {content[:60]!r}"
            raise FileFormatError(path, problem, number) from None
    telescope = _telescope(path, head)
    try:
        base_hz = 1e6 * float(head["base"][1])
    except (KeyError, ValueError):
        text = head["base"][1] if "base" in head else "none"
        problem = f"expected a base frequency in MHz in the head of the file, got {text}"
        raise FileFormatError(path, problem) from None
    return frequency_observations(
        path,
        agreements,
        catalogue,
        [Reading(*detection, ends=("", telescope)) for detection in detections],
        offset_hz=base_hz,
        count_s=float(head["dT"][1]) if "dT" in head else None,
    )


def _telescope(path: str | Path, head: Mapping[str, re.Match[str]]) -> str:
    """Return the telescope in the head of a file, or else in its name."""
    in_head = (head["day"][4] if "day" in head else "") or ""
    in_name = (_IN_NAME.search(Path(path).name) or ["", ""])[1]
    if in_head and in_name and in_head.upper() != in_name.upper():
        problem = (
            f"the telescope is {in_head} in the head and {in_name} in the file's name; correct one of them"
        )
        raise FileFormatError(path, problem)
    if not (in_head or in_name):
        problem = (
            "lacks the telescope, in the head and in its name; name it like Fdets.mex2013.12.28.Ww.r2i.txt"
        )
        raise FileFormatError(path, problem)
    return in_head or in_name


def _date_and_second(
    path: str | Path, number: int, time: str, scan: list[str], head: Mapping[str, re.Match[str]]
) -> tuple[str, float]:
    """Return the date of a record and its second of the day, which may go on counting; NaN if the date has a time."""
    if "T" in time:
        return time, math.nan
    second_of_day = float(time)
    if not 0.0 <= second_of_day < 2.0 * SECONDS_PER_DAY:
        raise ValueError
    if scan and "by_day" in head:
        return _day_of(float(scan[0])), second_of_day
    if "day" not in head:
        problem = "the day is missing in the records and in the head of the file; add it"
        raise FileFormatError(path, problem, number)
    return "-".join(head["day"].groups()[:3]), second_of_day


def _day_of(mjd: float) -> str:
    return str(Epochs.from_jd(MJD_ZERO_JD + mjd, 0.0, "UTC").day_strings()[0])
