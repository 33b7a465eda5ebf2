"""Orbit data files (ODF) of the Deep Space Network: their records, and the observations in them.

Doppler O is the reference frequency at the level of the downlink less the mean received one, Hz, positive where
the spacecraft recedes; its time tag is the middle of the count T_c. With the turnaround ratio M (one-way: 1) and
the reference frequency f_0 at the level of the uplink (one-way: of the downlink) the value is c O T_c / (M f_0).
Of coherent data it is cycles of the transmitted frequency, which the file has as ramps
(:mod:`radioloc.measurements.ramps`). A reference whose band is not that of the link is multiplied: of one-way data
by 880/240 from S to X band.

A sequential range is the integral of F f_T over the round trip in range units, ambiguous by multiples of 2^(n+6)
where n is the lowest component, and free of the station's delay. F is 1/2 in S band and smaller in others by the ratio
of the uplinks.

Epochs of records refer to the station's electronics. They are reduced to the antenna: tags are earlier by the receiving
delay, ramps later by the transmitting one.

A file is a sequence of records of 36 bytes, nine words of 32 bits with the highest bit first. It has groups, each begun
by a header: the group's key, a second key, the records of each item (1), the number of this record counted from 0, and
five zero words. The header of key -1 ends the data; zeros may fill the file up behind it. Times are seconds of UTC days
without leap seconds since the date in the file's label, 1950-01-01. The tables of bits below name the fields.

Sources: DSN External Interface Specification 820-013, TRK-2-18, Orbit Data File Interface, Revision E (2008); Moyer
(2003), sections 13.3.1, 13.3.2 and 13.5.
"""

from __future__ import annotations

import logging
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radioloc.constants import C_M_S
from radioloc.earth.stations import StationCatalogue, station_name
from radioloc.errors import DataQualityWarning, FileFormatError, in_file
from radioloc.measurements.link import Link
from radioloc.measurements.observations import Observations, without_duplicates
from radioloc.measurements.ramps import DOWNLINK, DOWNLINK_LIMITS_HZ, UPLINK, Ramps, turnaround_ratio
from radioloc.measurements.registry import TIME_TAGS, kind_of
from radioloc.quantities import accepts_quantities
from radioloc.text_files import read_bytes
from radioloc.time import Epochs
from radioloc.time.dates import utc_from_picoseconds
from radioloc.vectors import Indices, Mask

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


logger = logging.getLogger(__name__)

_ONE_WAY, _TWO_WAY, _THREE_WAY, _RANGE = 11, 12, 13, 37
KINDS = {_ONE_WAY: "one_way_doppler", _TWO_WAY: "doppler", _THREE_WAY: "doppler", _RANGE: "range"}
"""Types of measurement by modelled data type."""
TYPES = {
    **dict.fromkeys((1, 2, 3, 4), "narrowband VLBI"),
    **dict.fromkeys((5, 6), "wideband VLBI"),
    _ONE_WAY: "one-way Doppler",
    _TWO_WAY: "two-way Doppler",
    _THREE_WAY: "three-way Doppler",
    **dict.fromkeys((21, 22, 23), "total-count phase"),
    36: "range (PRA)",
    _RANGE: "sequential range (SRA)",
    41: "tone range",
    **dict.fromkeys(range(51, 59), "angles"),
}
"""Data types of the format."""
SIGMA_M = MappingProxyType({"S": 0.5e-3, "X": 0.15e-3, "Ka": 0.15e-3})
"""Sigma of Doppler over one second by the band of the downlink, m of light path; it grows as the root of the interval.
S and X band from the noise of GRAIL-B's counts of 1 s (0.4 to 0.6 and 0.12 to 0.18 mm, by fourth differences)."""
RANGE_SIGMA_M = 2.0
"""Sigma of a sequential range, m of the round trip."""

_BANDS = ("", "S", "X", "Ka")
_MAX_RANGE_RATE_M_S = 3e5
_NS = 10**9
_DAY_NS = 86400 * _NS


@accepts_quantities
def read_odf(
    path: str | Path, *, catalogue: StationCatalogue | None = None, sigma_m: Mapping[str, float] | None = None
) -> Observations:
    """Read the Doppler, ranges and ramps of an orbit data file, plain or gzip; `sigma_m` by type, m of light path."""
    odf = read_odf_file(path)
    codes, counts = np.unique(odf.orbit["type"], return_counts=True)
    for code in codes.tolist():
        if code not in TYPES:
            record = odf.orbit_record[np.argmax(odf.orbit["type"] == code)]
            raise odf_error(odf.path, f"unknown data type {code}", record)
    content = [f"{n} {TYPES[code]}" for code, n in zip(codes.tolist(), counts.tolist(), strict=True)]
    logger.info("%s: %s, %d ramps", odf.path, ", ".join(content) or "no data", len(odf.ramps))
    if len(foreign := np.flatnonzero(odf.orbit["spacecraft"] != odf.spacecraft)):
        problem = (
            f"expected spacecraft {odf.spacecraft} of the label, got {odf.orbit['spacecraft'][foreign[0]]}"
        )
        raise _record_error(odf, int(foreign[0]), f"{problem}; give the file of one spacecraft")
    if (odf.clocks["offset_s"] != 0).any() or (odf.clocks["offset_ns"] != 0).any():
        warnings.warn(
            f"{odf.path}: {len(odf.clocks)} records of clock offsets between stations are not applied; estimate or "
            "consider the clocks of these stations",
            DataQualityWarning,
            stacklevel=2,
        )
    rows, left_out = np.arange(len(odf.orbit)), []

    def leave_out(wrong: Mask, reason: str) -> None:
        nonlocal rows
        if wrong[rows].any():
            first = odf.orbit_record[rows[np.argmax(wrong[rows])]]
            left_out.append(f"{wrong[rows].sum()} {reason} (the first is record {first})")
            rows = rows[~wrong[rows]]

    leave_out(odf.orbit["invalid"] == 1, "marked as invalid")
    for code in set(codes.tolist()) - set(KINDS):
        leave_out(odf.orbit["type"] == code, f"of type {code} ({TYPES[code]}), which is not modelled")
    three_way = odf.orbit["transmitter"] != odf.orbit["receiver"]
    leave_out((odf.orbit["type"] == _RANGE) & three_way, "three-way ranges, which are not modelled")
    leave_out(_repeated_channels(odf.orbit, rows), "of another receiver of the station at the same time")
    columns = _columns(odf, rows, sigma_m or {})
    fast = np.zeros(len(odf.orbit), dtype=bool)
    fast[rows] = abs(columns["value_m"]) > _MAX_RANGE_RATE_M_S * columns["count_s"]
    used = ~fast[rows]
    leave_out(fast, f"with a range rate above {_MAX_RANGE_RATE_M_S / 1e3:g} km/s")
    if not len(rows):
        problem = f"expected usable Doppler or ranges, got none: {'; '.join(left_out) or 'no data'}"
        raise FileFormatError(odf.path, problem)
    if left_out:
        count = f"{len(odf.orbit) - len(rows)} of {len(odf.orbit)}"
        problem = f"{odf.path}: {count} records are left out: {'; '.join(left_out)}"
        warnings.warn(problem, DataQualityWarning, stacklevel=2)
    links, link = _links(odf, rows, catalogue)
    tagged = odf.orbit[rows]
    tag_ns = _NS * tagged["time_s"] + 10**6 * tagged["time_ms"] - tagged["receiver_delay_ns"]
    observations = Observations.from_columns(
        epoch=_utc(odf, tag_ns),
        links=links,
        link=link,
        tag=TIME_TAGS.index("receive"),
        files=(odf.path,),
        line=odf.orbit_record[rows],
        ramps=_ramps(odf, catalogue),
        **{name: column[used] for name, column in columns.items()},
    )
    return without_duplicates(observations)


def _repeated_channels(orbit: NDArray[np.void], rows: Indices) -> Mask:
    """Return the mask of Doppler that repeats a record of another channel, but for the frequencies."""
    key = ["time_s", "time_ms", "type", "receiver", "transmitter", "spacecraft", "uplink", "downlink"]
    _, first, group = np.unique(orbit[rows][key], return_index=True, return_inverse=True)
    doppler = orbit["type"][rows] != _RANGE  # The channel of a range is its component
    repeats = np.zeros(len(orbit), dtype=bool)
    repeats[rows] = doppler & (orbit["channel"][rows] != orbit["channel"][rows[first]][group])
    return repeats


def _columns(odf: OdfFile, rows: Indices, sigma_m: Mapping[str, float]) -> dict[str, NDArray[Any]]:
    """Return values, sigmas and frequencies of some records."""
    orbit = odf.orbit[rows]
    columns = {
        name: np.full(len(rows), np.nan)
        for name in ("value_m", "sigma_m", "wavelength_um", "uplink_hz", "count_s", "modulus_m")
    }
    columns |= {"kind": np.zeros(len(rows), np.int8), "ramped": orbit["independent"] == 1}
    observable = orbit["observable"] + 1e-9 * orbit["observable_1e9"]
    reference_hz = 1e-3 * (2**24 * orbit["reference_2e24_mhz"] + orbit["reference_mhz"])
    links = orbit[["type", "uplink", "downlink", "exciter"]]
    for link in np.unique(links):
        of_link = links == link
        first = int(rows[np.argmax(of_link)])
        code = int(link["type"])
        up, down, of_reference = (_BANDS[link[name]] for name in ("uplink", "downlink", "exciter"))
        one_way, kind = code == _ONE_WAY, KINDS[code]
        if not (down and of_reference and (up or one_way)):
            raise _record_error(odf, first, "lacks the band of uplink, downlink or reference frequency")
        carrier_hz = reference_hz[of_link] * (
            DOWNLINK[down] / DOWNLINK[of_reference]
            if one_way
            else float(turnaround_ratio(of_reference, down))
        )
        low_hz, high_hz = DOWNLINK_LIMITS_HZ[down]
        if (wrong := ~((carrier_hz > low_hz) & (carrier_hz < high_hz))).any():
            problem = f"a downlink in {down} band follows from its reference frequency at {carrier_hz[wrong][0]!r} Hz"
            raise _record_error(odf, int(rows[of_link][np.argmax(wrong)]), problem)
        columns["kind"][of_link] = kind_of(kind)
        columns["wavelength_um"][of_link] = 1e6 * C_M_S / carrier_hz
        if one_way:
            columns["ramped"][of_link] = False
        else:
            follows = of_link & (orbit["independent"] == 0)
            follows &= np.isin(orbit["transmitter"], odf.ramps["station"])
            if follows.any():
                problem = "a reference frequency from a ramped exciter is not modelled"
                raise _record_error(odf, int(rows[np.argmax(follows)]), problem)
            uplink_hz = carrier_hz / float(turnaround_ratio(up, down))
            columns["uplink_hz"][of_link] = uplink_hz
        if code == _RANGE:
            unit_m = C_M_S / (uplink_hz * UPLINK["S"] / (2.0 * UPLINK[up]))
            modulus = 2.0 ** (orbit["channel"][of_link] + 6)
            # A calibrated measurement may be below zero, or above the modulus.
            columns["value_m"][of_link] = unit_m * (modulus - -observable[of_link] % modulus)
            columns["modulus_m"][of_link] = unit_m * modulus
            columns["sigma_m"][of_link] = sigma_m.get(kind, RANGE_SIGMA_M)
        else:
            count_s = orbit["item_21"][of_link] / 100.0
            if not count_s.all():
                raise _record_error(odf, int(rows[of_link][np.argmin(count_s)]), "its count interval is zero")
            columns["count_s"][of_link] = count_s
            columns["value_m"][of_link] = C_M_S * observable[of_link] * count_s / carrier_hz
            columns["sigma_m"][of_link] = sigma_m.get(kind, SIGMA_M[down] * np.sqrt(count_s))
    return columns


def _links(odf: OdfFile, rows: Indices, catalogue: StationCatalogue | None) -> tuple[list[Link], Indices]:
    """Return the links of some records, and the index of each record's link."""
    orbit = odf.orbit[rows]
    ends = orbit[["type", "transmitter", "network", "receiver", "spacecraft"]]
    distinct, link = np.unique(ends, return_inverse=True)
    links = []
    for k, end in enumerate(distinct):
        sender = _station(int(end["transmitter"]), catalogue, int(end["network"]))
        one_way = end["type"] == _ONE_WAY
        if not end["receiver"] or not (end["transmitter"] or one_way):
            raise _record_error(odf, int(rows[np.argmax(link == k)]), "lacks the number of a station")
        receiver = _station(int(end["receiver"]), catalogue)
        links.append(Link("" if one_way else sender, f"sc{end['spacecraft']}", receiver))
    return links, link


def _ramps(odf: OdfFile, catalogue: StationCatalogue | None) -> Ramps:
    """Return the transmitted frequencies at the antennas."""
    ramps = odf.ramps
    sent = odf.orbit[np.isin(odf.orbit["type"], (_TWO_WAY, _THREE_WAY, _RANGE)) & (odf.orbit["invalid"] == 0)]
    names = {number: _station(number, catalogue) for number in np.unique(ramps["station"]).tolist()}

    def antenna_epochs(end: str) -> Epochs:
        time_ns = _NS * ramps[f"{end}_s"] + ramps[f"{end}_ns"]
        for number in names:
            rows, records = ramps["station"] == number, sent[sent["transmitter"] == number]
            if len(records):
                # The delay of the nearest record, so that the end of a ramp and the start of the next agree.
                records = np.sort(records, order=["time_s", "time_ms"])
                middles_s = 0.5 * (records["time_s"][1:] + records["time_s"][:-1])
                nearest = np.searchsorted(middles_s, 1e-9 * time_ns[rows])
                time_ns[rows] += records["transmitter_delay_ns"][nearest]
        return _utc(odf, time_ns)

    with in_file(odf.path):
        return Ramps.from_columns(
            [names[number] for number in ramps["station"].tolist()],
            antenna_epochs("start"),
            antenna_epochs("stop"),
            1e9 * ramps["frequency_ghz"] + ramps["frequency_hz"] + 1e-9 * ramps["frequency_nhz"],
            ramps["rate_hz_s"] + 1e-9 * ramps["rate_nhz_s"],
        )


def _station(number: int, catalogue: StationCatalogue | None, network: int = 0) -> str:
    """Return the name of a station by its number in the Deep Space Network (0) or in another network."""
    return station_name(catalogue, f"NETWORK{network}-{number}" if network else f"DSS-{number}")


def _record_error(odf: OdfFile, row: int, problem: str) -> FileFormatError:
    return odf_error(odf.path, problem, odf.orbit_record[row])


def _utc(odf: OdfFile, since_ns: NDArray[np.int64]) -> Epochs:
    """Return epochs from nanoseconds of days without leap seconds since the date in the label."""
    day, time = odf.reference
    try:
        start = date(day // 10000, day // 100 % 100, day % 100).toordinal() - date(1970, 1, 1).toordinal()
        days, ns = np.divmod(
            since_ns + _NS * (time // 10000 * 3600 + time // 100 % 100 * 60 + time % 100), _DAY_NS
        )
        return utc_from_picoseconds(start + days, 1000 * ns)
    except ValueError as error:  # InputError included
        raise FileFormatError(odf.path, f"times since {day} {time:06d} of the label: {error}") from None
