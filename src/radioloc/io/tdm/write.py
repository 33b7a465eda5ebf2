"""Writing of observations as a Tracking Data Message 2.0 in KVN.

:data:`radioloc.io.tdm.message.TYPES` has the keyword of each type: ranges as RANGE in km, Doppler as
DOPPLER_INTEGRATED (both of all legs), VLBI delays as VLBI_DELAY with two paths from the target. Observations that count
cycles of ramps have these as TRANSMIT_FREQ and TRANSMIT_FREQ_RATE: Doppler as RECEIVE_FREQ, ranges in range units of
:data:`RANGE_UNIT_S`, of time at the first frequency. Wavelengths become RECEIVE_FREQ or, of the target's own signal,
its TRANSMIT_FREQ. Numbers have the digits that restore them to the last bit, up to 17, where the standard asks for 16
at most (4.3.4); epochs have up to 12 decimals. The standard lacks standard deviations and the origin of observations.

Source: CCSDS 503.0-B-2 (2020), chapters 3 to 5.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from datetime import UTC, datetime
from decimal import Decimal
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from radioloc.constants import C_M_S
from radioloc.errors import InputError
from radioloc.io.frequencies import MAX_DURATION_S, MICROMETRES
from radioloc.io.tdm.message import (
    CODE,
    DATA,
    METADATA,
    SENT,
    SENT_RATE,
    TYPES,
    WEATHER,
    TdmFile,
    TdmHeader,
    TdmSegment,
    unit_exponent,
)
from radioloc.measurements.link import Link
from radioloc.measurements.observations import Observations
from radioloc.measurements.ramps import DOWNLINK, UPLINK, turnaround_ratio
from radioloc.measurements.registry import KINDS, MEASUREMENTS, TIME_TAGS
from radioloc.text_files import write_blocks
from radioloc.time import Epochs, utc_to_tai
from radioloc.time.dates import utc_to_text
from radioloc.vectors import Floats, Indices, Mask

RANGE_UNIT_S = 1e-9
"""Length of a range unit that is written, s; readers of the message need it as an agreement."""
_IN_MEMORY = "in memory"  # path of messages that are not from a file
_RATIO_TOLERANCE = 1e-3  # Doppler shifts are smaller, and the ratios of two bands differ by more
_MIN_WAVELENGTH_UM = 100.0  # The standard leaves laser ranging to its own format (3.5.2.7, note)
_FIXED_POINT_EXPONENTS = range(-5, 16)  # of numbers written without an exponent
_MIN_DATE_CHARACTERS = len("2020-12-31T23:59:60.000")
_BLOCK_ROWS = 2**14


def write_tdm(
    path: str | Path, observations: Observations, *, originator: str, comments: Iterable[str] = ()
) -> None:
    """Write observations as a message in KVN.

    :func:`radioloc.io.tdm.read_tdm` returns the rows to the last bit, ordered by path, type and time, with the
    standard deviations of its agreement. A value in metres that no VLBI delay in seconds or range rate gives exactly
    becomes its neighbour.

    Parameters
    ----------
    path : path-like
        The file; an existing one is replaced.
    observations : Observations
        Observations to write.
    originator : str
        Agency that makes the message.
    comments : iterable of str
        Comments for the header.

    Raises
    ------
    InputError
        The observations are empty or have a time tag at the bounce, laser light, a delay rate, cycles of missing ramps,
        or a name or comment that is not printable ASCII.
    FileFormatError
        The file cannot be written.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> import radioloc
    >>> from radioloc.io import TdmAgreement, read_tdm, write_tdm
    >>> path = pathlib.Path(tempfile.mkdtemp(), "ranges.tdm")
    >>> ranges = radioloc.read_observations("examples/change5/short_arc.csv")
    >>> write_tdm(path, ranges[:10], originator="MY AGENCY")
    >>> read_tdm(path, TdmAgreement(sigma_m={"range": 2.5}))
    <Observations 10 2020-12-01 to 2020-12-01>
    """
    header = TdmHeader(creation_date_now(), originator, tuple(comments))
    write_tdm_file(path, to_tdm(observations, header))


def creation_date_now() -> str:
    """Return the present UTC as the creation date of a CCSDS message."""
    return datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%S")


def write_tdm_file(path: str | Path, message: TdmFile) -> None:
    """Write a message of records in KVN, epochs in UTC."""
    write_blocks(path, _blocks(message))


def to_tdm(observations: Observations, header: TdmHeader) -> TdmFile:
    """Return the message of observations."""
    if len(observations) == 0:
        raise InputError("observations: expected at least one, got an empty table")
    _require_writable(observations)
    segments = [_segment(observations.select(rows)) for rows in _groups(observations)]
    return TdmFile(_IN_MEMORY, header, tuple(segments))


def _require_writable(observations: Observations) -> None:
    def refuse(rows: Mask, problem: str) -> None:
        if rows.any():
            row = int(np.argmax(rows))
            raise InputError(f"observation {row + 1} ({observations.origin(row)}) {problem}")

    bounce = observations.tag == TIME_TAGS.index("bounce")
    refuse(bounce, "has a time tag at the bounce; expected one at transmission or reception in a TDM")
    laser = observations.wavelength_um < _MIN_WAVELENGTH_UM
    refuse(laser, "is of laser light, which the standard excludes; use write_table")
    for kind in np.unique(observations.kind).tolist():
        rows, name = observations.kind == kind, KINDS[kind]
        if name not in TYPES:
            refuse(rows, f"is a {name}, for which the standard lacks a keyword; use write_table")
        if TYPES[name] != ("RANGE",):
            sent = rows & (observations.tag == TIME_TAGS.index("transmit"))
            refuse(sent, f"is a {name} with transmit time tag, which is not modelled")
        if not MEASUREMENTS[name].form.startswith("transmitter"):
            refuse(rows & ~np.isnan(observations.uplink_hz), f"is a {name} with an uplink; leave that out")


def _groups(observations: Observations) -> Iterator[Indices]:
    """Yield the rows of each segment, with the same metadata and the same recorded columns, in order of time."""
    differenced = np.array([link.differenced for link in observations.links])[observations.link]
    alike = [
        observations.link,
        observations.kind,
        observations.tag,
        np.nan_to_num(observations.count_s),
        np.isnan(observations.uplink_hz),
        np.isnan(observations.wavelength_um),
        observations.ramped,
        np.nan_to_num(observations.modulus_m),
        np.where(observations.ramped, np.nan_to_num(observations.uplink_hz), 0.0),
        # A segment has one frequency of delays, and one reference frequency of cycles.
        np.where(differenced | observations.ramped, np.nan_to_num(observations.wavelength_um), 0.0),
        *(np.isnan(getattr(observations, column)) for column in WEATHER.values()),
    ]
    # Most are the same for all rows.
    keys = [key for key in alike if key.min() != key.max()]
    order = np.lexsort((observations.epoch.fraction, observations.epoch.jd, *reversed(keys)))
    new = np.ones(len(order), dtype=bool)
    new[1:] = np.any([key[order[1:]] != key[order[:-1]] for key in keys], axis=0) if keys else False
    epoch = observations.epoch[order]
    later = np.concatenate([[True], (np.diff(epoch.jd) != 0.0) | (np.diff(epoch.fraction) != 0.0)])
    # The second observation at one epoch goes to a second segment, and so on.
    place = np.arange(len(order))
    turn = place - np.maximum.accumulate(np.where(new | later, place, 0))
    group = np.cumsum(new)
    by_segment = np.lexsort((turn, group))
    begins = (np.diff(group[by_segment]) != 0) | (np.diff(turn[by_segment]) != 0)
    yield from np.split(order[by_segment], np.flatnonzero(begins) + 1)


def _participants(link: Link) -> tuple[tuple[str, ...], int, dict[str, str]]:
    """Return the names of the participants, the number of the receiver, and the metadata of the path."""
    if link.differenced:
        paths = {"MODE": "SINGLE_DIFF", "PATH_1": "1,2", "PATH_2": "1,3"}
        return (link.target, link.transmitter, link.receiver), 3, paths
    if not link.transmitter:
        return (link.receiver, link.target), 1, {"MODE": "SEQUENTIAL", "PATH": "2,1"}
    if link.transmitter == link.receiver:
        return (link.transmitter, link.target), 1, {"MODE": "SEQUENTIAL", "PATH": "1,2,1"}
    return (link.transmitter, link.target, link.receiver), 3, {"MODE": "SEQUENTIAL", "PATH": "1,2,3"}


def _segment(part: Observations) -> TdmSegment:
    """Return the segment of observations with the same metadata."""
    link, keyword = part.links[part.link[0]], TYPES[KINDS[part.kind[0]]][0]
    dates = _date_texts(part.epoch[[0, -1]]).to_pylist()
    metadata = {"TIME_SYSTEM": "UTC", "START_TIME": dates[0], "STOP_TIME": dates[1]}
    names, receiver, paths = _participants(link)
    metadata |= paths | {f"PARTICIPANT_{n}": name for n, name in enumerate(names, start=1)}
    metadata["TIMETAG_REF"] = TIME_TAGS[part.tag[0]].upper()
    values: dict[str, Floats] = {}
    if part.ramped[0]:
        return _ramped_segment(part, metadata, keyword, receiver)
    if keyword == "RANGE":
        metadata |= _range_metadata(part, "km", 1.0)
        values[keyword] = part.value_m
    elif keyword == "DOPPLER_INTEGRATED":
        count_s = float(part.count_s[0])
        metadata |= _count_metadata(count_s)
        values[keyword] = _inverse(part.value_m, lambda rate: count_s * rate, part.value_m / count_s)
    else:
        values[keyword] = _inverse(part.value_m, lambda delay: C_M_S * delay, part.value_m / C_M_S)
    c_um_s = MICROMETRES * C_M_S
    received_hz = _inverse(part.wavelength_um, lambda hz: c_um_s / hz, c_um_s / part.wavelength_um)
    if link.differenced:
        values["TRANSMIT_FREQ_1"] = received_hz[:1]
    elif not link.transmitter:
        values["TRANSMIT_FREQ_2"] = received_hz
    else:
        values |= {"TRANSMIT_FREQ_1": part.uplink_hz, f"RECEIVE_FREQ_{receiver}": received_hz}
    return _recorded(part, metadata, values)


def _range_metadata(part: Observations, units: str, factor: float) -> dict[str, str]:
    modulus = _text(float(factor * np.nan_to_num(part.modulus_m[0])), unit_exponent("RANGE", units))
    one_way = {} if part.links[part.link[0]].transmitter else {"RANGE_MODE": "ONE_WAY"}
    return {"RANGE_MODULUS": modulus, "RANGE_UNITS": units} | one_way


def _count_metadata(count_s: float) -> dict[str, str]:
    return {"INTEGRATION_INTERVAL": _text(count_s, 0), "INTEGRATION_REF": "MIDDLE"}


def _recorded(part: Observations, metadata: dict[str, str], values: dict[str, Floats]) -> TdmSegment:
    """Return the segment of columns, NaN where a record is missing, with the weather of the observations."""
    values = values | {keyword: getattr(part, column) for keyword, column in WEATHER.items()}
    records = []
    for keyword, column in values.items():
        if not np.isnan(column).all():
            # A frequency is written where it changes, since it holds until the next.
            held = "FREQ" in keyword and "FREQ_OFFSET" not in metadata
            changes = np.diff(column, prepend=np.nan) != 0.0 if held else np.isfinite(column)
            places = np.flatnonzero(changes)
            records.append((np.full(len(places), CODE[keyword], dtype=np.int8), places, column[places]))
    code, place, value = (np.concatenate(column) for column in zip(*records, strict=True))
    order = np.lexsort((code, place))
    line = np.zeros(len(order), dtype=np.int32)
    return TdmSegment(_IN_MEMORY, metadata, code[order], part.epoch[place[order]], value[order], {}, line)


def _ramped_segment(part: Observations, metadata: dict[str, str], keyword: str, receiver: int) -> TdmSegment:
    """Return the segment of observations that count cycles, after the ramps from the day before on."""
    link, ramps, ends = part.links[part.link[0]], part.ramps, utc_to_tai(part.epoch[[0, -1]])
    number, sender = (1, link.transmitter) if link.transmitter else (2, link.target)
    sent = ramps.station == ([*ramps.stations, sender].index(sender))
    sent &= ramps.start.seconds_since(ends[[1]]) <= np.nan_to_num(part.count_s[0])
    sent &= ramps.start.seconds_since(ends[[0]]) + ramps.duration_s >= -MAX_DURATION_S
    if not sent.any():
        raise InputError(f"{link.path}: expected a ramp of {sender} by {part.origin(0)}, got none; add it")
    start, rows = ramps.start_utc[sent], np.flatnonzero(sent)
    ratio = _turnaround(part) if link.transmitter else Fraction(1)
    reference_hz = float(
        part.uplink_hz[0] if link.transmitter else MICROMETRES * C_M_S / part.wavelength_um[0]
    )
    if link.transmitter:
        metadata["TURNAROUND_NUMERATOR"] = str(ratio.numerator)
        metadata["TURNAROUND_DENOMINATOR"] = str(ratio.denominator)
    if keyword == "RANGE":
        unit_per_m = reference_hz / ramps.frequency_hz[rows[0]] / (C_M_S * RANGE_UNIT_S)
        metadata |= _range_metadata(part, "RU", unit_per_m)
        measured = {keyword: unit_per_m * part.value_m}
    else:
        count_s = float(part.count_s[0])
        offset_hz = float(round(ratio * Fraction(reference_hz)))
        metadata |= _count_metadata(count_s) | {"FREQ_OFFSET": _text(offset_hz, 0)}
        at_rest_hz = float(ratio * Fraction(reference_hz) - Fraction(offset_hz))
        shift_hz = float(ratio) * reference_hz * part.value_m / (C_M_S * count_s)
        measured = {f"RECEIVE_FREQ_{receiver}": at_rest_hz - shift_hz}
    recorded = _recorded(part, metadata, measured)
    code = np.tile([CODE[SENT[number - 1]], CODE[SENT_RATE[number - 1]]], len(rows)).astype(np.int8)
    value = np.column_stack([ramps.frequency_hz[rows], ramps.rate_hz_s[rows]]).ravel()
    return replace(
        recorded,
        keyword=np.concatenate([code, recorded.keyword]),
        epoch=Epochs.concatenate([start[np.repeat(np.arange(len(rows)), 2)], recorded.epoch]),
        value=np.concatenate([value, recorded.value]),
        line=np.zeros(len(code) + len(recorded.line), dtype=np.int32),
    )


def _turnaround(part: Observations) -> Fraction:
    """Return the transponder's ratio, by the bands of the frequencies up and down."""
    recorded = C_M_S * MICROMETRES / part.wavelength_um[0] / part.uplink_hz[0]
    ratios = [turnaround_ratio(up, down) for up in UPLINK for down in DOWNLINK]
    matches = [ratio for ratio in ratios if abs(recorded / ratio - 1.0) < _RATIO_TOLERANCE]
    if not matches:
        expected = "expected a ratio of S, X and Ka band of the frequencies down and up"
        raise InputError(f"{part.origin(0)}: {expected}, got {recorded:.6g}; use write_table")
    return matches[0]


def _inverse(values: Floats, forward: Callable[[Floats], Floats], guess: Floats) -> Floats:
    """Return the first number next to a guess that a conversion maps to a value exactly, else the guess."""
    if np.isnan(guess).all():
        return guess
    short = np.array([float(f"{value:.15g}") for value in guess.tolist()])
    up, down = np.nextafter(guess, np.inf), np.nextafter(guess, -np.inf)
    candidates = (short, guess, up, down, np.nextafter(up, np.inf), np.nextafter(down, -np.inf))
    return np.select([forward(candidate) == values for candidate in candidates], candidates, default=guess)


def _blocks(message: TdmFile) -> Iterator[bytes]:
    header = message.header
    fields = {"CREATION_DATE": header.creation_date, "ORIGINATOR": header.originator}
    yield _lines("CCSDS_TDM_VERS = 2.0", *_fields(header.comments, fields))
    for segment in message.segments:
        metadata = {**segment.metadata, "TIME_SYSTEM": "UTC"}
        fields = {keyword: metadata[keyword] for keyword in METADATA if keyword in metadata}
        yield _lines("META_START", *_fields(segment.comments, fields), "META_STOP")
        yield _lines("DATA_START", *_fields(segment.data_comments, {}))
        yield from _records(segment)
        yield _lines("DATA_STOP")


def _lines(*texts: str) -> bytes:
    return "".join(f"{text}\n" for text in texts).encode()


def _fields(comments: Iterable[str], fields: Mapping[str, str]) -> Iterator[str]:
    """Yield lines of comments and of keywords with their texts, which must be printable ASCII and not empty."""
    lines = [f"COMMENT {line}" for comment in comments for line in comment.split("\n")]
    for keyword, text in fields.items():
        if not text.strip():
            raise InputError(f"{keyword}: expected a text, got an empty one")
        lines.append(f"{keyword} = {text}")
    for line in lines:
        if not (line.isascii() and line.isprintable()):
            raise InputError(f"expected one line of printable ASCII text in a TDM, got {line!r}")
        yield line


def _records(segment: TdmSegment) -> Iterator[bytes]:
    import pyarrow as pa
    import pyarrow.compute as pc

    starts = pa.array([f"{keyword} = " for keyword in DATA])
    units = segment.metadata.get("RANGE_UNITS", "km")
    for start in range(0, len(segment.line), _BLOCK_ROWS):
        rows = slice(start, start + _BLOCK_ROWS)
        code, value = segment.keyword[rows], segment.value[rows]
        keywords = np.unique(code).tolist()
        texts = [_value_texts(value[code == k], unit_exponent(DATA[k], units)) for k in keywords]
        order = np.argsort(np.argsort(code, kind="stable"), kind="stable")
        dates = pc.binary_join_element_wise(starts.take(pa.array(code)), _date_texts(segment.epoch[rows]), "")
        lines = pc.binary_join_element_wise(dates, pa.concat_arrays(texts).take(pa.array(order)), " ")
        block = pa.ListArray.from_arrays([0, len(lines)], lines)
        yield pc.binary_join(block, "\n")[0].as_buffer().to_pybytes() + b"\n"


def _date_texts(utc: Epochs) -> Any:
    """Return dates with as many decimals as they need, at least three, as an Arrow array."""
    import pyarrow as pa
    import pyarrow.compute as pc

    return pc.utf8_rpad(pc.utf8_rtrim(pa.array(utc_to_text(utc)), "0"), _MIN_DATE_CHARACTERS, "0")


def _value_texts(values: Floats, exponent: int) -> Any:
    """Return the texts of :func:`_text` of many numbers as an Arrow array."""
    import pyarrow as pa
    import pyarrow.compute as pc

    if exponent < 0:
        return pa.array([_text(value, exponent) for value in values.tolist()])
    # The decimal point moves to the left in Arrow's texts; Python writes whole numbers and unusual forms.
    form = rf"(\d{{{exponent}}})(?:\.|$)"
    texts = pc.replace_substring_regex(pa.array(values).cast(pa.string()), form, r".\1", max_replacements=1)
    texts = pc.utf8_rtrim(texts, "0")
    unusual = pc.invert(pc.match_substring_regex(texts, r"^-?\d+\.\d+$"))
    exact = [_text(v, exponent) for v in values[unusual.to_numpy(zero_copy_only=False)].tolist()]
    return pc.replace_with_mask(texts, unusual, pa.array(exact, pa.string()))


def _text(value: float, exponent: int) -> str:
    """Return the shortest decimal number that, times a power of ten, gives a float back."""
    if not math.isfinite(value):
        raise InputError(f"expected finite values in a TDM, got {value}; leave the record out")
    number = Decimal(repr(value)).scaleb(-exponent)
    if number.is_zero() or number.adjusted() in _FIXED_POINT_EXPONENTS:
        text = format(number, "f")
        return text if "." in text else f"{text}.0"
    sign, digits, _ = number.normalize().as_tuple()
    first, *decimals = map(str, digits)
    return f"{'-' * sign}{first}.{''.join(decimals) or '0'}E{number.adjusted():+03d}"
