"""Observations from Tracking Data Messages: interpretation of the segments, and measurements in metres.

:data:`radioloc.io.tdm.message.TYPES` lists the keywords that become observations. TRANSMIT_FREQ, CLOCK_BIAS and weather
of any segment are used with them. Angles, powers, magnitudes and media are counted and ignored. Measurements of the
path that are not modelled are refused.

A range holds at its time tag; INTEGRATION_INTERVAL is the count interval of Doppler. Received frequencies count cycles
of the transmitted one (:mod:`radioloc.io.frequencies`). Cycles of a constant frequency are a length. Observations of a
changing frequency are `ramped`, in metres by the first frequency, and the model integrates the ramps. The same holds
for ranges in range units.

Source: CCSDS 503.0-B-2 (2020), sections 3.3 to 3.5 and table 3-3.
"""

from __future__ import annotations

import logging
import warnings
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from radioloc.constants import C_M_S
from radioloc.earth.stations import StationCatalogue
from radioloc.errors import DataQualityWarning, FileFormatError, InputError
from radioloc.io.frequencies import MICROMETRES, range_change_m
from radioloc.io.tdm.agreement import TdmAgreement
from radioloc.io.tdm.message import (
    MEASURED,
    NOT_MODELLED,
    RANGE_RATES,
    RECEIVED,
    SENT,
    TYPES,
    TdmFile,
    TdmSegment,
    unit_exponent,
)
from radioloc.io.tdm.segment import Reading, SegmentReader
from radioloc.measurements.observations import Observations, without_duplicates, without_second
from radioloc.measurements.registry import KINDS, MEASUREMENTS, TIME_TAGS
from radioloc.measurements.table_columns import FLIGHT_TIME_LIMITS_S
from radioloc.vectors import Floats

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, eq=False)
class TdmReadout:
    """Observations from messages, with the ignored records and the corrections applied."""

    observations: Observations  # segment by segment, in each by keyword, in order of time
    ignored: Mapping[str, int]  # number of unused records by keyword
    notes: tuple[str, ...]  # corrections of values and time tags


def tdm_observations(
    files: TdmFile | Sequence[TdmFile], agreement: TdmAgreement, *, catalogue: StationCatalogue | None = None
) -> TdmReadout:
    """Make observations of one or more messages, which may complement each other.

    Frequencies, clocks and weather of one message hold for the measurements of all. Stations that are not in the
    catalogue keep the names of the files. Missing or contradictory data, and modes, paths and measurements that are not
    modelled, are a :class:`FileFormatError` with the line; degraded data are a :class:`DataQualityWarning`.
    """
    messages = [files] if isinstance(files, TdmFile) else list(files)
    if not messages:
        raise InputError("files: expected at least one message, got an empty list")
    segments = [segment for message in messages for segment in message.segments]
    reading = Reading(segments, agreement, catalogue)
    parts: list[Observations] = []
    # Values that overflow become infinite and are refused with their line.
    with np.errstate(over="ignore", invalid="ignore"):
        for segment in segments:
            parts += _read_segment(reading, segment)
    if kinds := reading.without_sigma:
        error = next(iter(kinds.values()))
        in_python, in_study = (
            ", ".join(form.format(kind) for kind in kinds) for form in ("{!r}: ...", "{} = ...")
        )
        options = " ".join(f"--sigma {kind}=..." for kind in kinds)
        problem = (
            f"{error.problem}; give sigma_m = {{{in_python}}}, in metres (in a study file [observations] sigma_m = "
            f"{{ {in_study} }}, to radioloc convert {options})"
        )
        raise FileFormatError(error.path, problem, error.line)
    counts = [segment.counts() for segment in segments]
    if not parts:
        held = ", ".join(sorted({keyword for count in counts for keyword in count}))
        raise FileFormatError(reading.files[0], f"expected range, Doppler or VLBI delay, got {held}")
    observations = Observations.concatenate(parts) if len(parts) > 1 else parts[0]
    observations = without_duplicates(observations)
    ignored: Counter[str] = Counter()
    for segment, count in zip(segments, counts, strict=True):
        ignored.update({k: n for k, n in count.items() if (segment, k) not in reading.used})
    readout = TdmReadout(observations, dict(ignored), tuple(dict.fromkeys(reading.notes)))
    unused = ", ".join(f"{number} {keyword}" for keyword, number in ignored.items()) or "none"
    lines = [", ".join(observations.files), *readout.notes, f"ignored records: {unused}"]
    _log.info("%s", "\n".join(lines))
    return readout


def _read_segment(reading: Reading, segment: TdmSegment) -> list[Observations]:
    """Return the observations of one segment, by keyword."""
    metadata, held = segment.metadata, [k for k in segment.counts() if k in MEASURED]
    # Received frequencies beside range rates, or beside ranges without a count interval, only give the wavelength.
    stronger = {*RANGE_RATES, *(["RANGE"] if "INTEGRATION_INTERVAL" not in metadata else [])}
    measured = [keyword for keyword in held if keyword not in RECEIVED or not stronger & set(held)]
    if not measured:
        return []
    part = SegmentReader(reading, segment)
    if metadata.get("DATA_QUALITY") == "DEGRADED":
        line = segment.line_of("DATA_QUALITY")
        message = f"{segment.path}, line {line}: DATA_QUALITY is DEGRADED"
        warnings.warn(message, DataQualityWarning, stacklevel=4)
    reading.used |= {(segment, keyword) for keyword in measured}
    return [_read(part, keyword) for keyword in measured]


def _read(part: SegmentReader, keyword: str) -> Observations:
    """Return the observations of the records of a keyword."""
    if keyword in NOT_MODELLED:
        problem = "is not modelled; convert it to RECEIVE_FREQ or leave it out"
        raise part.fail(keyword, f"{keyword} {problem}")
    held = {k: words for k, words in TYPES.items() if MEASUREMENTS[k].form == part.link.form}
    kind = next((kind for kind, keywords in held.items() if keyword in keywords), None)
    if kind is None:
        mode = part.segment.metadata["MODE"]
        modelled = ", ".join(dict.fromkeys(k for keywords in held.values() for k in keywords[:2]))
        raise part.fail(keyword, f"expected {modelled} on the path of MODE = {mode}, got {keyword}")
    if part.tag not in MEASUREMENTS[kind].tags or (part.tag != "receive" and keyword != "RANGE"):
        problem = f"expected TIMETAG_REF = RECEIVE of {keyword}, got {part.tag.upper()}"
        raise part.fail("TIMETAG_REF", problem)
    columns = part.weather(keyword) | {"links": [part.link]} | VALUES[keyword](part, keyword)
    if columns["links"][0].form != part.link.form:
        kind = "doppler"  # the agreement names the transmitter of a one-way path
    files = part.reading.files
    sigma_m = columns.pop("sigma_m", part.agreement.sigma_m.get(kind))
    if sigma_m is None:
        part.reading.without_sigma.setdefault(kind, part.fail(keyword, "a TDM does not state sigmas"))
        sigma_m = 1.0
    observations = Observations.from_columns(
        sigma_m=sigma_m,
        kind=KINDS.index(kind),
        tag=TIME_TAGS.index(part.tag),
        files=files,
        file=files.index(part.segment.path),
        line=part.segment.line[part.segment.rows(keyword)],
        **columns,
    )
    if keyword in RECEIVED:
        # Peaks of a spectrum that are picked by hand are often recorded twice; the first counts.
        epoch = observations.epoch
        repeated = np.flatnonzero((np.diff(epoch.jd) == 0.0) & (np.diff(epoch.fraction) == 0.0))
        observations = without_second(
            observations, repeated, repeated + 1, "a repeated frequency of this epoch"
        )
    return observations


INSTANTANEOUS_COUNT_S = 1.0
"""Count interval of instantaneous range rates, s.

Over a second the mean rate differs from the rate at its middle by a 24th of the path's third derivative, 2e-7 m/s
for a station on the rotating Earth.
"""
_MAX_DIFFERENCED_SHIFT = 1000.0 / C_M_S  # Two stations on the equator separate at up to 2 x 465 m/s


def _ranges(part: SegmentReader, keyword: str) -> dict[str, Any]:
    """Return the columns of RANGE: light path of the round trip, or from the target."""
    epoch = part.tagged(keyword)
    units = part.segment.metadata.get("RANGE_UNITS", "km")
    unit_m = _range_unit_m(part, units)
    factor = unit_m * 10.0 ** unit_exponent(keyword, units)
    modulus_m = part.segment.number("RANGE_MODULUS") * factor
    correction_m = part.segment.correction("RANGE") * factor
    if part.link.differenced:
        delay_s = part.differenced_delay_s()
    else:
        ends = [("TRANSMIT", part.sender), ("RECEIVE", part.receiver)]
        if not part.one_way:
            ends[1:1] = [("RECEIVE", part.target), ("TRANSMIT", part.target)]
        delay_s = part.delay_s(*(f"{way}_DELAY_{n}" for way, n in ends))
    value_m = unit_m * part.segment.values(keyword)
    value_m = part.less_delays(keyword, value_m, delay_s, correction_m)
    if modulus_m and part.link.differenced:
        problem = f"expected an unambiguous difference of ranges, got one modulo {modulus_m:.6g} m"
        raise part.fail("RANGE_MODULUS", f"{problem}; resolve it and set RANGE_MODULUS = 0")
    columns: dict[str, Any] = {"epoch": epoch, "value_m": value_m} | part.frequencies(keyword)
    if units == "RU" and part.sent is not None:
        columns |= part.cycles(keyword, float(part.sent.value[0]))
    if modulus_m and (not part.agreement.lunar or modulus_m < C_M_S * FLIGHT_TIME_LIMITS_S[1]):
        return columns | {"modulus_m": modulus_m}
    _require_plausible(part, value_m)
    return columns


def _range_unit_m(part: SegmentReader, units: str) -> float:
    """Return the metres of light path in one unit of RANGE (m where the file has km)."""
    mode = part.segment.metadata.get("RANGE_MODE", "")
    if mode and (mode == "ONE_WAY") != part.down_only:
        path = "from the target to a station" if part.down_only else "to the target and back"
        raise part.fail("RANGE_MODE", f"RANGE_MODE is {mode}, but PATH is {path}; correct one of them")
    if units == "RU" and part.agreement.range_unit_s is None:
        problem = "RANGE_UNITS is RU, the length of which is agreed between agencies"
        raise part.fail("RANGE_UNITS", f"{problem}; give range_unit_s (in a study file tdm_range_unit_s)")
    halves = 2.0 if part.agreement.range_convention == "half" and not part.down_only else 1.0
    return halves * {"km": 1.0, "s": C_M_S, "RU": C_M_S * (part.agreement.range_unit_s or 0.0)}[units]


def _require_plausible(part: SegmentReader, value_m: Floats) -> None:
    """Refuse ranges that are not between Earth and Moon, such as those of the other convention."""
    if not part.agreement.lunar or part.link.differenced:
        return
    low_m, high_m = (C_M_S * limit * (0.5 if part.one_way else 1.0) for limit in FLIGHT_TIME_LIMITS_S)
    way = "one way" if part.one_way else "there and back"
    limits = f"between Earth and Moon it is {low_m / 1000.0:.6g} to {high_m / 1000.0:.6g} km"
    fits = (value_m > low_m) & (value_m < high_m)
    convention = part.agreement.range_convention
    factor, alternative = (2.0, "half") if convention == "round_trip" else (0.5, "round_trip")
    of_alternative = (factor * value_m > low_m) & (factor * value_m < high_m) & ~fits
    if of_alternative.any() and not part.one_way:
        row = int(np.argmax(of_alternative))
        path = f"RANGE gives a light path of {value_m[row] / 1000.0:.6g} km {way}, taken as {convention!r}"
        advice = f'off by a factor of two: set tdm_range = "{alternative}"'
        raise part.fail("RANGE", f"{path}; {limits}, {advice}", row)
    if part.reading.catalogue is not None and not fits.all():
        row = int(np.argmin(fits))
        problem = f"RANGE is {value_m[row] / 1000.0:.6g} km {way}, but {limits}"
        raise part.fail("RANGE", f"{problem}; correct it or leave it out", row)


def _count_interval(part: SegmentReader, keyword: str) -> tuple[float, float]:
    """Return the count interval, s, and the offset of its middle from the time tag, s."""
    for name in ("INTEGRATION_INTERVAL", "INTEGRATION_REF"):
        if name not in part.segment.metadata:
            problem = f"{keyword} needs {name}; add it to the metadata"
            raise part.fail(keyword, problem)
    count_s = part.segment.number("INTEGRATION_INTERVAL")
    offset = {"START": 0.5, "MIDDLE": 0.0, "END": -0.5}[part.segment.metadata["INTEGRATION_REF"]]
    return count_s, offset * count_s


def _range_rates(part: SegmentReader, keyword: str) -> dict[str, Any]:
    """Return the columns of DOPPLER_INTEGRATED or DOPPLER_INSTANTANEOUS: mean rate of the light path."""
    if len(set(part.segment.counts()) & set(RANGE_RATES)) > 1:
        raise part.fail(keyword, "mean and instantaneous range rates of one signal; leave one of them out")
    integrated = keyword == "DOPPLER_INTEGRATED"
    count_s, middle_s = _count_interval(part, keyword) if integrated else (INSTANTANEOUS_COUNT_S, 0.0)
    halves = 2.0 if part.agreement.doppler_convention == "half" and not part.down_only else 1.0
    rate_m_s = part.segment.values(keyword) + 1000.0 * part.segment.correction("DOPPLER")
    return {
        "epoch": part.tagged(keyword, middle_s),
        "value_m": halves * count_s * rate_m_s,
        "count_s": count_s,
    } | part.frequencies(keyword)


def _received(part: SegmentReader, keyword: str) -> dict[str, Any]:
    """Return the columns of RECEIVE_FREQ or RECEIVE_FREQ_n: mean received frequency."""
    if part.link.differenced:
        return _received_difference(part, keyword)
    if keyword not in ("RECEIVE_FREQ", f"RECEIVE_FREQ_{part.receiver}"):
        raise part.fail(keyword, f"{keyword}: PATH ends at participant {part.receiver}; correct one of them")
    count_s, middle_s = _count_interval(part, keyword)
    agreed, link = part.agreed, part.link
    if part.sent is not None:
        base_hz = float(part.sent.value[0])
    elif agreed is not None:
        base_hz = agreed.transmit_hz
    else:
        sender = part.segment.participant(part.sender)
        problem = f"{keyword} needs TRANSMIT_FREQ_{part.sender} of {sender}; add it, in any segment"
        raise part.fail(keyword, f"{problem}, or transmit_hz under [[observations.frequencies]]")
    if part.sent is None and agreed is not None and agreed.transmitter and part.one_way:
        link, ratio = replace(link, transmitter=part.reading.station(agreed.transmitter)), agreed.turnaround
    else:
        ratio = part.turnaround() or (agreed.turnaround if agreed is not None else None)
    if ratio is None:
        problem = "needs the transponder's ratio; give TURNAROUND_NUMERATOR and _DENOMINATOR, or turnaround"
        raise part.fail(keyword, f"{keyword} {problem} (in a study file tdm_turnaround)")
    epoch = part.tagged(keyword, middle_s)
    offset_hz = part.segment.number("FREQ_OFFSET")
    value_hz = part.segment.values(keyword) + part.segment.correction("RECEIVE")
    fail = partial(part.fail, keyword)
    value_m = range_change_m(value_hz, offset_hz, base_hz, ratio, count_s, fail)
    received_hz = offset_hz + value_hz
    columns = {"epoch": epoch, "value_m": value_m, "count_s": count_s} | part.frequencies(keyword)
    columns["wavelength_um"] = MICROMETRES * C_M_S / np.where(received_hz > 0.0, received_hz, np.nan)
    if part.sent is None and link.transmitter:
        columns["uplink_hz"] = base_hz
    columns |= part.cycles(keyword, base_hz)
    return columns | {"links": [link]} | _sigma_of_frequency(part, count_s, base_hz * ratio[0] / ratio[1])


def _sigma_of_frequency(part: SegmentReader, count_s: float, nominal_hz: float) -> dict[str, float]:
    """Return the sigma of Doppler where that of its frequencies is agreed on."""
    return {} if part.agreed is None else {"sigma_m": C_M_S * count_s * part.agreed.sigma_hz / nominal_hz}


def _received_difference(part: SegmentReader, keyword: str) -> dict[str, Any]:
    """Return the columns of RECEIVE_FREQ of two paths: frequency at the second station less that at the first."""
    count_s, middle_s = _count_interval(part, keyword)
    beacon_hz = part.beacon_hz(keyword)
    if np.isnan(beacon_hz):
        name = SENT[part.target - 1]
        problem = f"{keyword} of two paths needs {name}, one frequency that the target sends; add it"
        raise part.fail(keyword, f"{problem}, or transmit_hz under [[observations.frequencies]]")
    shift_hz = (
        part.segment.values(keyword) + part.segment.number("FREQ_OFFSET") + part.segment.correction("RECEIVE")
    )
    if (np.abs(shift_hz) > _MAX_DIFFERENCED_SHIFT * beacon_hz).any():
        row = int(np.argmax(np.abs(shift_hz)))
        limit = f"{_MAX_DIFFERENCED_SHIFT * beacon_hz:.6g} Hz"
        problem = (
            f"expected a difference of two received frequencies, up to {limit}, got {float(shift_hz[row])!r}"
        )
        raise part.fail(keyword, f"{keyword}: {problem}", row)
    return (
        {
            "epoch": part.tagged(keyword, middle_s),
            "value_m": -C_M_S * count_s * shift_hz / beacon_hz,
            "count_s": count_s,
        }
        | part.frequencies(keyword)
        | _sigma_of_frequency(part, count_s, beacon_hz / np.sqrt(2.0))
    )


def _delays(part: SegmentReader, keyword: str) -> dict[str, Any]:
    """Return the columns of VLBI_DELAY or DOR: arrival at the second station less that at the first."""
    for name in ("CORRECTION_RANGE", "CORRECTION_RECEIVE", "CORRECTION_TRANSMIT"):
        if name in part.segment.metadata and part.segment.metadata.get("CORRECTIONS_APPLIED") == "NO":
            raise part.fail(
                name, f"{name}: the standard does not define it for {keyword}; apply it to the data"
            )
    value_m = C_M_S * part.segment.values(keyword)
    value_m = part.less_delays(keyword, value_m, part.differenced_delay_s())
    if part.segment.number("RANGE_MODULUS"):
        part.note(f"RANGE_MODULUS of ranges is not applied to {keyword}")
    return {"epoch": part.tagged(keyword), "value_m": value_m} | part.frequencies(keyword)


VALUES: Mapping[str, Callable[[SegmentReader, str], dict[str, Any]]] = {
    "RANGE": _ranges,
    **dict.fromkeys(RANGE_RATES, _range_rates),
    **dict.fromkeys(RECEIVED, _received),
    **dict.fromkeys(("VLBI_DELAY", "DOR"), _delays),
}
"""Functions that return columns of observations, with epoch and value_m, from the records of a data keyword."""
