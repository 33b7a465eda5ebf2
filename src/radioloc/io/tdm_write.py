"""Observations as a Tracking Data Message 2.0, KVN or XML.

Ranges are written as RANGE in km, the whole light path; Doppler as DOPPLER_INTEGRATED, the rate of the whole light
path; VLBI delays as VLBI_DELAY with two paths from the target. Numbers have the digits that give them back to the
last bit, up to 17, where the standard asks for 16 at most (4.3.4); epochs have up to 12 decimals.

Not in the standard, and so not written: standard deviations, and where the observations were read from. Whole
wavelengths become RECEIVE_FREQ or, of a delay, TRANSMIT_FREQ.

Source: CCSDS 503.0-B-2 (2020), chapters 3 to 5.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from datetime import UTC, datetime
from decimal import Decimal
from html import escape
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from radioloc.constants import C_M_S
from radioloc.errors import InputError
from radioloc.io.dates import utc_to_text
from radioloc.io.tdm_file import TdmFile, TdmHeader, TdmSegment
from radioloc.io.tdm_keywords import CODE, DATA, METADATA, exponent_of
from radioloc.io.tdm_weather import COLUMNS
from radioloc.measurements.measurement_type import TIME_TAGS
from radioloc.measurements.observations import DOPPLER, RANGE, VLBI_DELAY, VLBI_DELAY_RATE, Observations
from radioloc.text_files import write_blocks
from radioloc.time import Epochs

_MICROMETRES = 1e6
# Light is not radio: laser ranging has its own format, and the standard leaves it out (3.5.2.7, note).
_SHORTEST_UM = 100.0
_KEYWORDS = {RANGE: "RANGE", DOPPLER: "DOPPLER_INTEGRATED", VLBI_DELAY: "VLBI_DELAY"}
_FIXED = range(-5, 16)
_SHORTEST_DATE = len("2020-12-31T23:59:60.000")
_ROWS_AT_ONCE = 2**14
_XML_START = (
    '<?xml version="1.0" encoding="UTF-8"?>\n'
    '<tdm xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance" '
    'xsi:noNamespaceSchemaLocation="https://sanaregistry.org/r/ndmxml_unqualified/ndmxml-2.0.0-master-2.0.xsd" '
    'id="CCSDS_TDM_VERS" version="2.0">'
)


def write_tdm(
    path: str | Path,
    observations: Observations,
    *,
    originator: str,
    creation_date: str | None = None,
    message_id: str = "",
    comments: Iterable[str] = (),
) -> None:
    """Write observations as a message: XML where the file's name ends in ``.xml``, else KVN.

    :func:`radioloc.io.tdm.read_tdm` gives the rows back to the last bit, ordered by path, kind and time, with the
    standard deviations of its agreement. A value in metres that no VLBI delay in seconds or range rate gives
    exactly comes back as its neighbour.

    Parameters
    ----------
    path : path-like
        The file; an existing one is replaced.
    observations : Observations
        What to write.
    originator : str
        Agency that makes the message.
    creation_date : str, optional
        UTC date of the message; now by default.
    message_id : str
        The agency's name for the message.
    comments : iterable of str
        Comments for the header.

    Raises
    ------
    InputError
        There are no observations, or some that a message cannot hold: a time tag at the bounce, laser light, a delay
        rate, a name or comment that is not printable ASCII.
    FileFormatError
        The file cannot be written.
    """
    now = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%S")
    header = TdmHeader(creation_date or now, originator, message_id, tuple(comments))
    write_tdm_file(path, tdm_of(observations, header))


def write_tdm_file(path: str | Path, message: TdmFile) -> None:
    """Write a message as its records: XML where the file's name ends in ``.xml``, else KVN; epochs in UTC.

    Raises
    ------
    InputError
        A text is not printable ASCII or empty.
    FileFormatError
        The file cannot be written.
    """
    is_xml = Path(path).suffix.lower() == ".xml"
    write_blocks(path, _xml_blocks(message) if is_xml else _kvn_blocks(message))


def tdm_of(observations: Observations, header: TdmHeader) -> TdmFile:
    """Message that holds observations; arguments and errors as those of :func:`write_tdm`."""
    if len(observations) == 0:
        raise InputError("there are no observations to write")
    _require_writable(observations)
    segments = [_segment(observations, rows) for rows in _groups(observations)]
    return TdmFile("in memory", header, tuple(segments))


def _require_writable(observations: Observations) -> None:
    laser = observations.wavelength_um < _SHORTEST_UM
    refused = {
        "is tagged at the bounce; a TDM has time tags at transmission and reception only": (
            observations.tag == TIME_TAGS.index("bounce")
        ),
        "is of laser light, which the standard leaves out; use write_table": laser,
        "is a VLBI delay rate, for which the standard has no keyword; use write_table": (
            observations.kind == VLBI_DELAY_RATE
        ),
        "is Doppler tagged at transmission, which is not modelled": (
            (observations.kind == DOPPLER) & (observations.tag != TIME_TAGS.index("receive"))
        ),
        "is a VLBI delay with an uplink; leave that out": (
            (observations.kind == VLBI_DELAY) & ~np.isnan(observations.uplink_hz)
        ),
    }
    for problem, rows in refused.items():
        if rows.any():
            row = int(np.argmax(rows))
            raise InputError(f"observation {row + 1} ({observations.origin(row)}) {problem}")


def _groups(observations: Observations) -> Iterator[NDArray[np.intp]]:
    """Rows of each segment: alike in all that metadata say and in what is recorded, in order of time."""
    alike = [
        observations.link,
        observations.kind,
        observations.tag,
        np.nan_to_num(observations.count_s),
        np.isnan(observations.uplink_hz),
        np.isnan(observations.wavelength_um),
        # A delay's one frequency stands for its whole segment.
        np.where(observations.kind == VLBI_DELAY, np.nan_to_num(observations.wavelength_um), 0.0),
        *(np.isnan(getattr(observations, column)) for column in COLUMNS.values()),
    ]
    group = np.zeros(len(observations), dtype=np.int64)
    for key in alike:
        # Most are the same for all rows.
        if key.min() != key.max():
            different, place = np.unique(key, return_inverse=True)
            _, group = np.unique(group * len(different) + place, return_inverse=True)
    order = np.lexsort((observations.epoch.fraction, observations.epoch.jd, group))
    epoch = observations.epoch[order]
    same = (np.diff(group[order]) == 0) & (np.diff(epoch.jd) == 0.0) & (np.diff(epoch.fraction) == 0.0)
    # Of several at one epoch the second goes to a second segment, and so on.
    start = np.maximum.accumulate(np.where(np.concatenate([[True], ~same]), np.arange(len(order)), 0))
    turn = np.arange(len(order)) - start
    again = np.lexsort((np.arange(len(order)), turn, group[order]))
    keys = np.stack([group[order][again], turn[again]])
    yield from np.split(order[again], np.flatnonzero((np.diff(keys) != 0).any(axis=0)) + 1)


def _segment(observations: Observations, rows: NDArray[np.intp]) -> TdmSegment:
    part = observations.select(rows)
    kind, link = int(part.kind[0]), part.links[part.link[0]]
    dates = _date_texts(part.epoch[[0, -1]]).tolist()
    metadata = {"TIME_SYSTEM": "UTC", "START_TIME": dates[0], "STOP_TIME": dates[1]}
    if kind == VLBI_DELAY:
        names = (link.target, link.transmitter, link.receiver)
        metadata |= {"MODE": "SINGLE_DIFF", "PATH_1": "1,2", "PATH_2": "1,3"}
    else:
        two_way = link.transmitter == link.receiver
        names = (link.transmitter, link.target, *(() if two_way else (link.receiver,)))
        metadata |= {"MODE": "SEQUENTIAL", "PATH": "1,2,1" if two_way else "1,2,3"}
    metadata |= {f"PARTICIPANT_{n}": name for n, name in enumerate(names, start=1)}
    metadata["TIMETAG_REF"] = TIME_TAGS[part.tag[0]].upper()
    values: dict[str, NDArray[np.float64]] = {}
    received_hz = _inverse(
        part.wavelength_um, lambda hz: _MICROMETRES * C_M_S / hz, _MICROMETRES * C_M_S / part.wavelength_um
    )
    if kind == RANGE:
        metadata |= {"RANGE_MODULUS": "0.0", "RANGE_UNITS": "km"}
        values["RANGE"] = part.value_m
    elif kind == DOPPLER:
        count_s = float(part.count_s[0])
        metadata |= {"INTEGRATION_INTERVAL": _text(count_s, 0), "INTEGRATION_REF": "MIDDLE"}
        values["DOPPLER_INTEGRATED"] = _inverse(
            part.value_m, lambda rate: count_s * rate, part.value_m / count_s
        )
    else:
        values["VLBI_DELAY"] = _inverse(part.value_m, lambda delay: C_M_S * delay, part.value_m / C_M_S)
    if kind == VLBI_DELAY:
        values["TRANSMIT_FREQ_1"] = received_hz[:1]
    else:
        values["TRANSMIT_FREQ_1"] = part.uplink_hz
        values[f"RECEIVE_FREQ_{1 if two_way else 3}"] = received_hz
    values |= {keyword: getattr(part, column) for keyword, column in COLUMNS.items()}
    records = [
        (np.full(len(places), CODE[keyword], dtype=np.int8), places, column[places])
        for keyword, column in values.items()
        if len(places := _places(keyword, column))
    ]
    code, place, value = (np.concatenate(column) for column in zip(*records, strict=True))
    order = np.lexsort((code, place))
    return TdmSegment(
        metadata,
        code[order],
        part.epoch[place[order]],
        value[order],
        {},
        np.zeros(len(order), dtype=np.int32),
    )


def _places(keyword: str, column: NDArray[np.float64]) -> NDArray[np.intp]:
    """Rows at which a column is written: a frequency where it changes, since it holds until the next."""
    if np.isnan(column).all():
        return np.empty(0, dtype=np.intp)
    if "FREQ" in keyword:
        return np.flatnonzero(np.concatenate([[True], np.diff(column) != 0.0]))
    return np.arange(len(column))


def _inverse(
    wanted: NDArray[np.float64],
    forward: Callable[[NDArray[np.float64]], NDArray[np.float64]],
    guess: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Of numbers next to a guess the first from which a conversion gives exactly what is wanted, else the guess.

    Tried are the guess in 15 digits (as a file may have given it), itself and its four nearest floats.
    """
    if np.isnan(guess).all():
        return guess
    short = np.array([float(f"{value:.15g}") for value in guess.tolist()])
    up, down = np.nextafter(guess, np.inf), np.nextafter(guess, -np.inf)
    near = (short, guess, up, down, np.nextafter(up, np.inf), np.nextafter(down, -np.inf))
    return np.select([forward(candidate) == wanted for candidate in near], near, default=guess)


def _kvn_blocks(message: TdmFile) -> Iterator[bytes]:
    header = message.header
    yield _lines(
        [
            "CCSDS_TDM_VERS = 2.0",
            *(f"COMMENT {_printable(comment)}" for comment in _split_lines(header.comments)),
            *(f"{keyword} = {value}" for keyword, value in _header_fields(header).items()),
        ]
    )
    for segment in message.segments:
        yield _lines(
            [
                "META_START",
                *(f"COMMENT {_printable(comment)}" for comment in _split_lines(segment.comments)),
                *(f"{keyword} = {value}" for keyword, value in _metadata_fields(segment).items()),
                "META_STOP",
                "DATA_START",
                *(f"COMMENT {_printable(comment)}" for comment in _split_lines(segment.data_comments)),
            ]
        )
        yield from _record_lines(segment, lambda keyword: ("", f"{keyword} = ", " ", ""))
        yield _lines(["DATA_STOP"])


def _xml_blocks(message: TdmFile) -> Iterator[bytes]:
    header = message.header
    yield _lines(
        [
            _XML_START,
            "<header>",
            *_elements(("COMMENT", _printable(comment)) for comment in _split_lines(header.comments)),
            *_elements(_header_fields(header).items()),
            "</header>",
            "<body>",
        ]
    )
    for segment in message.segments:
        yield _lines(
            [
                "<segment>",
                "<metadata>",
                *_elements(("COMMENT", _printable(text)) for text in _split_lines(segment.comments)),
                *_elements(_metadata_fields(segment).items()),
                "</metadata>",
                "<data>",
                *_elements(("COMMENT", _printable(text)) for text in _split_lines(segment.data_comments)),
            ]
        )
        yield from _record_lines(
            segment,
            lambda keyword: (
                "<observation><EPOCH>",
                "",
                f"</EPOCH><{keyword}>",
                f"</{keyword}></observation>",
            ),
        )
        yield _lines(["</data>", "</segment>"])
    yield _lines(["</body>", "</tdm>"])


def _lines(texts: Sequence[str]) -> bytes:
    return "".join(f"{text}\n" for text in texts).encode()


def _elements(fields: Iterable[tuple[str, str]]) -> Iterator[str]:
    return (f"<{keyword}>{escape(value, quote=False)}</{keyword}>" for keyword, value in fields)


def _split_lines(comments: Iterable[str]) -> Iterator[str]:
    return (line for comment in comments for line in comment.split("\n"))


def _header_fields(header: TdmHeader) -> dict[str, str]:
    fields = {"CREATION_DATE": header.creation_date, "ORIGINATOR": header.originator}
    fields |= {"MESSAGE_ID": header.message_id} if header.message_id else {}
    return {keyword: _value(keyword, text) for keyword, text in fields.items()}


def _metadata_fields(segment: TdmSegment) -> dict[str, str]:
    metadata: Mapping[str, str] = {**segment.metadata, "TIME_SYSTEM": "UTC"}
    return {keyword: _value(keyword, metadata[keyword]) for keyword in METADATA if keyword in metadata}


def _value(keyword: str, text: str) -> str:
    if not text.strip():
        raise InputError(f"{keyword} is empty; give a text")
    return _printable(text)


def _printable(text: str) -> str:
    if not (text.isascii() and text.isprintable()):
        raise InputError(f"{text!r} cannot stand in a TDM; give printable ASCII text of one line")
    return text


def _record_lines(segment: TdmSegment, around: Callable[[str], tuple[str, str, str, str]]) -> Iterator[bytes]:
    """Records as lines: what stands before the epoch (two texts), between it and the value, and behind."""
    from pyarrow import array, compute

    first, second, between, behind = (array(texts) for texts in zip(*map(around, DATA), strict=True))
    units = segment.metadata.get("RANGE_UNITS", "km")
    for start in range(0, len(segment.line), _ROWS_AT_ONCE):
        rows = slice(start, start + _ROWS_AT_ONCE)
        code, value = segment.keyword[rows], segment.value[rows]
        values = np.empty(len(code), dtype=object)
        for keyword in np.unique(code).tolist():
            mine = code == keyword
            values[mine] = _value_texts(value[mine], exponent_of(DATA[keyword], units))
        place = array(code)
        lines = compute.binary_join_element_wise(
            *(texts.take(place) for texts in (first, second)),
            array(_date_texts(segment.epoch[rows])),
            between.take(place),
            array(values, "string"),
            behind.take(place),
            "",
        )
        yield _lines(lines.to_pylist())


def _value_texts(values: NDArray[np.float64], exponent: int) -> list[str]:
    """As :func:`_text`, of many numbers."""
    from pyarrow import array, compute

    if exponent < 0:
        return [_text(value, exponent) for value in values.tolist()]
    # The point moves to the left in what Arrow writes; numbers of unusual size are left to Python.
    form = rf"^(?P<sign>-?)(?P<whole>\d*?)(?P<moved>\d{{0,{exponent}}})(?:\.(?P<part>\d+))?$"
    found = compute.extract_regex(array(values).cast("string"), form)
    sign, whole, moved, part = found.flatten()
    part = compute.binary_join_element_wise(compute.utf8_lpad(moved, exponent, "0"), part, "")
    part = compute.utf8_lpad(compute.utf8_rtrim(part, "0"), 1, "0")
    whole = compute.utf8_lpad(whole, 1, "0")
    texts = compute.binary_join_element_wise(sign, whole, ".", part, "").to_pylist()
    return [_text(v, exponent) if t is None else t for t, v in zip(texts, values.tolist(), strict=True)]


def _date_texts(utc: Epochs) -> NDArray[np.str_]:
    """Dates with as many decimals as they need, three at the least."""
    texts = utc_to_text(utc)
    short = np.strings.rstrip(texts, "0")
    return np.where(np.strings.str_len(short) < _SHORTEST_DATE, texts.astype(f"U{_SHORTEST_DATE}"), short)


def _text(value: float, exponent: int) -> str:
    """Shortest decimal number that, times a power of ten, gives a float back."""
    if not math.isfinite(value):
        raise InputError(f"{value} cannot stand in a TDM; leave the record out")
    number = Decimal(repr(value)).scaleb(-exponent)
    if number.is_zero() or number.adjusted() in _FIXED:
        text = format(number, "f")
        return text if "." in text else f"{text}.0"
    sign, digits, _ = number.normalize().as_tuple()
    first, *rest = map(str, digits)
    return f"{'-' * sign}{first}.{''.join(rest) or '0'}E{number.adjusted():+03d}"
