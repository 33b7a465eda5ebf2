"""Records of an orbit data file (ODF) of the Deep Space Network, field by field.

A file is a sequence of records of 36 bytes, nine words of 32 bits with the highest bit first. It has groups, each begun
by a header: the group's key, a second key, the records of each item (1), the number of this record counted from 0, and
five zero words. The header of key -1 ends the data; zeros may fill the file up behind it. Times are seconds of UTC days
without leap seconds since the date in the file's label, 1950-01-01. The tables of bits below name the fields.

Source: DSN External Interface Specification 820-013, TRK-2-18, Orbit Data File Interface, Revision E (2008).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from radioloc.errors import FileFormatError
from radioloc.text_files import read_bytes

RECORD_BYTES = 36
FORMAT = 2  # of the records of orbit data, the only one since 1997

_LABEL, _IDENTIFIER, _ORBIT, _RAMPS, _CLOCKS, _SUMMARY, _END = 101, 107, 109, 2030, 2040, 105, -1
_NAMES = {
    _LABEL: "file label",
    _IDENTIFIER: "identifier",
    _ORBIT: "orbit data",
    _RAMPS: "ramps",
    _CLOCKS: "clock offsets",
    _SUMMARY: "data summary",
    _END: "end of file",
}
# Names of fields and their numbers of bits, negative for signed fields.
_ORBIT_FIELDS = (
    "time_s 32, time_ms 10, receiver_delay_ns 22, observable -32, observable_1e9 -32, format 3, receiver 7, "
    "transmitter 7, network 2, type 6, downlink 2, uplink 2, exciter 2, invalid 1, channel 7, spacecraft 10, "
    "independent 1, reference_2e24_mhz 22, reference_mhz 24, item_20 -20, item_21 22, "
    "transmitter_delay_ns 22"
)
_RAMP_FIELDS = (
    "start_s 32, start_ns 32, rate_hz_s -32, rate_nhz_s -32, frequency_ghz 22, station 10, frequency_hz 32, "
    "frequency_nhz 32, stop_s 32, stop_ns 32"
)
_CLOCK_FIELDS = (
    "start_s 32, start_ns 32, offset_s -32, offset_ns -32, station 32, second_station 32, reserved 32, "
    "stop_s 32, stop_ns 32"
)


@dataclass(frozen=True, slots=True, eq=False)
class OdfFile:
    """Content of an orbit data file; structured arrays of whole numbers have one row per record."""

    path: str
    spacecraft: int  # number in the Deep Space Network; with a minus sign usually the NAIF code
    # Epoch of the times: date (YYYYMMDD) and time (HHMMSS).
    reference: tuple[int, int]
    # Measurements. ``observable_1e9`` is the observable's fraction, ``reference_2e24_mhz`` the part of the reference
    # frequency above 2^24 millihertz. ``item_21`` of Doppler is the count interval in hundredths of a second,
    # ``channel`` of ranges the number of the lowest component.
    orbit: NDArray[np.void]
    ramps: NDArray[np.void]  # transmitted frequencies, all groups
    clocks: NDArray[np.void]  # differences of clocks
    orbit_record: NDArray[np.int32]  # number of each record of orbit data in the file, counted from 1


def looks_like_odf(head: bytes) -> bool:
    """Return whether the first bytes are the header of a file label."""
    return head[:RECORD_BYTES] == np.array([_LABEL, 0, 1, *[0] * 6], dtype=">u4").tobytes()


def read_odf_file(path: str | Path) -> OdfFile:
    """Read the content of an orbit data file; a :class:`FileFormatError` names the record that is wrong."""
    content = read_bytes(path)
    if not looks_like_odf(content):
        raise FileFormatError(path, "does not begin with the file label of an orbit data file (key 101)")
    if excess_bytes := len(content) % RECORD_BYTES:
        problem = f"ends {excess_bytes} bytes into record {len(content) // RECORD_BYTES + 1}"
        raise FileFormatError(path, f"{problem}: it was cut or is damaged; fetch it again")
    words = np.frombuffer(content, dtype=">u4").reshape(-1, 9).astype(np.uint32)
    groups = _groups(path, words)

    def record_numbers(*keys: int) -> NDArray[np.int32]:
        """Return the numbers of the records of groups, from 0."""
        numbers = [np.arange(header + 1, end) for key, header, end in groups if key in keys]
        return np.concatenate([np.zeros(0, dtype=int), *numbers]).astype(np.int32)

    for key in (_LABEL, _IDENTIFIER):
        if len(record_numbers(key)) != 1:
            problem = f"the group {_NAMES[key]} has {len(record_numbers(key))} records; there must be one"
            raise FileFormatError(path, problem)
    [label] = words[record_numbers(_LABEL)]
    orbit = _fields(words[record_numbers(_ORBIT)], _ORBIT_FIELDS)
    if (wrong := orbit["format"] != FORMAT).any():
        row = int(np.argmax(wrong))
        problem = f"expected data of format {FORMAT} (1997 and later), got {orbit['format'][row]}"
        raise odf_error(path, problem, int(record_numbers(_ORBIT)[row]) + 1)
    ramps = _fields(words[record_numbers(_RAMPS)], _RAMP_FIELDS)
    stations = [
        station
        for key, header, end in groups
        if key == _RAMPS
        for station in [words[header, 1]] * (end - header - 1)
    ]
    if (wrong := ramps["station"] != stations).any():
        row = int(np.argmax(wrong))
        problem = f"a ramp of station {ramps['station'][row]} is in the group of station {stations[row]}"
        raise odf_error(path, problem, int(record_numbers(_RAMPS)[row]) + 1)
    return OdfFile(
        path=str(path),
        spacecraft=int(label[4]),
        reference=(int(label[7]), int(label[8])),
        orbit=orbit,
        ramps=ramps,
        clocks=_fields(words[record_numbers(_CLOCKS)], _CLOCK_FIELDS),
        orbit_record=record_numbers(_ORBIT) + 1,
    )


def odf_error(path: str | Path, problem: str, record: int) -> FileFormatError:
    """Return an error in a record, counted from 1."""
    return FileFormatError(path, f"record {record}: {problem}")


def _groups(path: str | Path, words: NDArray[np.uint32]) -> list[tuple[int, int, int]]:
    """Return the key, the header and the end of each group, counted from 0; checks the headers."""
    # The last five words of data are never all zero: they hold stations and times.
    headers = np.flatnonzero(~words[:, 4:].any(axis=1))
    keys = words[:, 0].astype(np.int32)
    groups: list[tuple[int, int, int]] = []
    for header, end in zip(headers.tolist(), [*headers[1:].tolist(), len(words)], strict=True):
        key = int(keys[header])
        if key not in _NAMES:
            keys_text = ", ".join(f"{number} ({name})" for number, name in _NAMES.items())
            raise odf_error(
                path, f"expected a header with one of the keys {keys_text}, got {key}", header + 1
            )
        if words[header, 3] != header:
            problem = (
                f"the header of the group {_NAMES[key]} says that it is record {int(words[header, 3]) + 1}"
            )
            raise odf_error(
                path, f"{problem}: records are missing or were put in; fetch the file again", header + 1
            )
        if key == _END:
            behind = words[header + 1 :].any(axis=1)
            if behind.any():
                record = header + 2 + int(np.argmax(behind))
                raise odf_error(path, "expected only zeros after the end of file", record)
            return groups
        groups.append((key, header, end))
    problem = "ends without its last record (key -1): it was cut; fetch it again"
    raise FileFormatError(path, problem)


def _fields(words: NDArray[np.uint32], table: str) -> NDArray[np.void]:
    """Return the fields of some records as a structured array."""
    fields = [(name, abs(int(bits)), int(bits) < 0) for name, bits in map(str.split, table.split(", "))]
    array = np.empty(len(words), dtype=[(name, np.int64) for name, _, _ in fields])
    padded = np.pad(words.astype(np.uint64), ((0, 0), (0, 1)))
    bit = 0
    for name, width, signed in fields:
        pair = padded[:, bit // 32] << np.uint64(32) | padded[:, bit // 32 + 1]
        array[name] = pair >> np.uint64(64 - bit % 32 - width) & np.uint64(2**width - 1)
        if signed:
            array[name] -= (array[name] >> (width - 1)) << width
        bit += width
    return array
