"""Received frequencies as STRF and its rffit write them (``.dat``), and the sites that they name.

A line is the time of the middle of an integration (modified Julian date, UTC; in older files ``yy/mm/dd hh:mm:ss.s``),
the frequency of the signal's peak (Hz), its strength, which is not used, and the number of the site. A second site is
that of a transmitter whose signal the target reflects. Sites are stations called ``COSPAR 4171``, as tracking messages
of the same observers call them.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from radioloc.constants import SECONDS_PER_DAY
from radioloc.earth.stations import Station, StationCatalogue
from radioloc.errors import FileFormatError, InputError
from radioloc.io.checks import midnight_and_second
from radioloc.io.frequencies import FrequencyAgreement, Reading, frequency_observations
from radioloc.measurements.observations import Observations
from radioloc.text_files import read_lines

_JD_MJD_0 = 2400000.5
_MJD_SPAN = (41317, 88069)  # 1972 to 2099
_NUMBER = r"[+-]?\d+(?:\.\d*)?(?:[eE][+-]?\d+)?"
_READING = re.compile(
    r"(?:(\d{5})(\.\d+)|(\d\d)/(\d\d)/(\d\d)\s+(\d\d):(\d\d):(\d\d(?:\.\d*)?))"
    r"\s+(\d{1,15}(?:\.\d*)?)\s+\S+\s+(\d{1,4})(?:\s+(\d{1,4}))?",
    re.ASCII,
)
_SITE = re.compile(rf"(\d{{1,4}})\s+\S+\s+({_NUMBER})\s+({_NUMBER})\s+({_NUMBER})(?:\s.*)?", re.ASCII)


def looks_like_strf(lines: list[str]) -> bool:
    """Whether the first line that says something is a reading."""
    first = next((line for line in lines if _said(line)), "")
    return _READING.fullmatch(_said(first)) is not None


def read_strf(
    path: str | Path, agreements: Sequence[FrequencyAgreement], *, catalogue: StationCatalogue | None = None
) -> Observations:
    r"""Read a file of received frequencies, plain or gzip, as Doppler.

    Parameters
    ----------
    path : path-like
        The file.
    agreements : sequence of FrequencyAgreement
        What files do not say; the first that holds for this one counts.
    catalogue : StationCatalogue, optional
        Gives stations their catalogue names; a site that it does not know stays ``COSPAR`` and its number.

    Raises
    ------
    FileFormatError
        The file cannot be read, or a line of it; names the line.

    Warns
    -----
    DataQualityWarning
        An epoch is there twice, and its first frequency counted.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> from radioloc.io import FrequencyAgreement, read_strf
    >>> path = pathlib.Path(tempfile.mkdtemp(), "night.dat")
    >>> _ = path.write_text("59184.250000\t8463700123.500\t  10.0\t4171\n")
    >>> beacon = FrequencyAgreement(transmit_hz=8463.7e6, sigma_hz=0.5, count_s=10.0)
    >>> print(read_strf(path, [beacon]).summary())
    1 observations, 2020-12-01T06:00:00 to 2020-12-01T06:00:00 UTC, 1 file(s)
      lander>COSPAR 4171  one_way_doppler        1
    """
    readings = []
    for number, text in enumerate(read_lines(path, ended=True), start=1):
        if not (said := _said(text)):
            continue
        if (match := _READING.fullmatch(said)) is None:
            problem = (
                f"{said[:60]!r} is not a reading: date (MJD), frequency (Hz), strength and number of the site"
            )
            raise FileFormatError(path, problem, number)
        mjd, part, year, *rest, second, frequency, receiver, transmitter = match.groups()
        if mjd is None:
            month, day, hour, minute = map(int, rest)
            date = 2000 + int(year), month, day, hour, minute, float(second)
            midnight, second_of_day = midnight_and_second(path, number, *date)
        elif _MJD_SPAN[0] <= int(mjd) <= _MJD_SPAN[1]:
            midnight, second_of_day = _JD_MJD_0 + int(mjd), SECONDS_PER_DAY * float(part)
        else:
            raise FileFormatError(
                path, f"the modified Julian date {mjd} is not of the years 1972 to 2099", number
            )
        ends = _site_name(transmitter) if transmitter else "", _site_name(receiver)
        readings.append(Reading(midnight, second_of_day, float(frequency), number, ends))
    return frequency_observations(path, agreements, catalogue, readings)


def read_sites(path: str | Path) -> tuple[Station, ...]:
    """Read a file of sites (``sites.txt``: number, initials, latitude, longitude, height, observer) as stations.

    Their coordinates, degrees with four decimals and metres above the sea, are good to some tens of metres.

    Raises
    ------
    FileFormatError
        The file cannot be read, or a line of it; names the line. There is no site in it.

    Examples
    --------
    >>> from radioloc.io import read_sites
    >>> [station.name for station in read_sites("examples/beacon/sites.txt")]
    ['COSPAR 9001', 'COSPAR 9002', 'COSPAR 9003']
    """
    stations: dict[str, Station] = {}
    for number, text in enumerate(read_lines(path), start=1):
        if not (said := _said(text)):
            continue
        if (match := _SITE.fullmatch(said)) is None:
            problem = (
                f"{said[:60]!r} is not a site: number, initials, latitude, longitude (deg) and height (m)"
            )
            raise FileFormatError(path, problem, number)
        name, (latitude, longitude, height_m) = _site_name(match[1]), map(float, match.groups()[1:])
        try:
            made = Station.from_geodetic(
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
        except InputError as error:
            raise FileFormatError(path, str(error), number) from None
        if name in stations:
            raise FileFormatError(path, f"site {match[1]} is there twice; leave one of them out", number)
        stations[name] = made
    if not stations:
        raise FileFormatError(
            path, "has no site: number, initials, latitude, longitude (deg) and height (m) on a line"
        )
    return tuple(stations.values())


def _said(line: str) -> str:
    """A line without its comment; one without a digit, such as a heading, says nothing."""
    said = line.partition("#")[0].strip()
    return said if any(map(str.isdigit, said)) else ""


def _site_name(number: str) -> str:
    return f"COSPAR {number.zfill(4)}"
