"""Frequency detections of radio telescopes (PRIDE's Fdets): topocentric frequencies of a spacecraft's carrier.

Comments at the start say the day, the telescope, the base frequency (MHz) and, in newer files, the integration time
(dT). A record then is the time (UTC date, or second of the day), signal to noise, spectral maximum, the frequency above
the base (Hz) and what is left of it after a fit (Hz); before the time may stand a scan number, or the day as a modified
Julian date. The time is the middle of the integration. Molera Calves et al. (2021), PASA 38, e065.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from radioloc.constants import SECONDS_PER_DAY
from radioloc.earth.stations import StationCatalogue
from radioloc.errors import FileFormatError
from radioloc.io.checks import midnight_and_second
from radioloc.io.frequencies import FrequencyAgreement, Reading, frequency_observations
from radioloc.measurements.observations import Observations
from radioloc.text_files import read_lines
from radioloc.time import Epochs

_COMMENT = ("#", "//", "*")
_HEAD = {
    "base": re.compile(r"base frequency:\s*(\S+)\s*MHz", re.IGNORECASE),
    "day": re.compile(r"conducted on (\d{4})[.-](\d\d)[.-](\d\d)(?: at (\w+))?", re.IGNORECASE | re.ASCII),
    "dT": re.compile(r"\bdT:\s*(\d+(?:\.\d*)?)\s*s", re.ASCII),
    "by_day": re.compile(r"format\s*:\s*(modified|mjd)", re.IGNORECASE),
}
_DATE = re.compile(r"(\d{4})-(\d\d)-(\d\d)T(\d\d):(\d\d):(\d\d(?:\.\d*)?)Z?", re.ASCII)
_IN_NAME = re.compile(r"Fdets\.[^.]+\.\d\d\.\d\d[^.]*\.(\w+)\.")
_JD_MJD_0 = 2400000.5


def looks_like_fdets(lines: list[str]) -> bool:
    """Whether the comments that a file starts with say a base frequency."""
    head = [line for line in lines[:10] if line.lstrip().startswith(_COMMENT)]
    return bool(head) and head[0] == lines[0] and any(_HEAD["base"].search(line) for line in head)


def read_fdets(
    path: str | Path, agreements: Sequence[FrequencyAgreement], *, catalogue: StationCatalogue | None = None
) -> Observations:
    r"""Read a file of frequency detections, plain or gzip, as Doppler.

    Parameters
    ----------
    path : path-like
        The file; where its comments do not say the telescope its name does, ``Fdets.mex2013.12.28.Ww.r2i.txt``.
    agreements : sequence of FrequencyAgreement
        What files do not say; the first that holds for this one counts.
    catalogue : StationCatalogue, optional
        Gives stations their catalogue names; a telescope's two letters that it does not know stay.

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
    >>> from radioloc.io import FrequencyAgreement, read_fdets
    >>> path = pathlib.Path(tempfile.mkdtemp(), "Fdets.lander.Wz.txt")
    >>> _ = path.write_text(
    ...     "# Observation conducted on 2013.12.28 at Ww\n# Base frequency: 8412.00 MHz dT: 5 s\n"
    ...     "2013-12-28T09:30:05.000 3000.0 0.1 8005012.5 1e-3\n"
    ... )
    >>> read_fdets(path, [FrequencyAgreement(transmit_hz=8.42e9, sigma_hz=0.01)])
    <Observations 1 2013-12-28 to 2013-12-28>
    """
    head: dict[str, re.Match[str]] = {}
    detections = []
    for number, text in enumerate(read_lines(path, ended=True), start=1):
        if not (said := text.strip()) or said.startswith(_COMMENT):
            for name, form in _HEAD.items():
                if name not in head and (match := form.search(said)):
                    head[name] = match
            continue
        fields = said.split()
        try:
            *before, time, _, _, detected, _ = fields
            if len(before) > 1:
                raise ValueError
            moment = _midnight_and_second(path, number, time, before, head)
            detections.append((*moment, float(detected), number))
        except FileFormatError:
            raise
        except ValueError:
            problem = (
                f"{said[:60]!r} is not a detection: time, signal to noise, maximum, frequency and residual"
            )
            raise FileFormatError(path, problem, number) from None
    telescope = (head["day"][4] if "day" in head else "") or (_IN_NAME.search(Path(path).name) or ["", ""])[1]
    if not telescope:
        problem = "does not say the telescope, nor does its name; call it as Fdets.mex2013.12.28.Ww.r2i.txt"
        raise FileFormatError(path, problem)
    try:
        base_hz = 1e6 * float(head["base"][1])
    except (KeyError, ValueError):
        given = head["base"][1] if "base" in head else "missing"
        problem = f"the base frequency is {given}; write its megahertz into the head of the file"
        raise FileFormatError(path, problem) from None
    return frequency_observations(
        path,
        agreements,
        catalogue,
        [Reading(*detection, ends=("", telescope)) for detection in detections],
        offset_hz=base_hz,
        count_s=float(head["dT"][1]) if "dT" in head else None,
    )


def _midnight_and_second(
    path: str | Path, number: int, time: str, before: list[str], head: Mapping[str, re.Match[str]]
) -> tuple[float, float]:
    """Julian date of midnight and second of the day (it may be past its end) of a record."""
    if match := _DATE.fullmatch(time):
        *date, second = match.groups()
        year, month, day, hour, minute = map(int, date)
        return midnight_and_second(path, number, year, month, day, hour, minute, float(second))
    second_of_day = float(time)
    if not 0.0 <= second_of_day < 2.0 * SECONDS_PER_DAY:
        raise ValueError
    if before and "by_day" in head:
        date_of = Epochs.from_jd(_JD_MJD_0 + float(before[0]), 0.0, "UTC").day_strings()[0]
    elif "day" in head:
        date_of = "-".join(head["day"].groups()[:3])
    else:
        raise FileFormatError(
            path, "the day is neither in the records nor in the head of the file; add it", number
        )
    year, month, day = map(int, date_of.split("-"))
    return midnight_and_second(path, number, year, month, day, 0, 0, 0.0)[0], second_of_day
