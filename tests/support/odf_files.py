"""Orbit data files bit by bit, independent of the reader."""

import struct
from itertools import groupby


def _bits(table):
    return {name: int(width) for name, width in (field.split() for field in table.split(","))}


ORBIT = _bits(
    "time_s 32, time_ms 10, receiver_delay_ns 22, observable 32, observable_1e9 32, format 3, receiver 7,"
    "transmitter 7, network 2, type 6, downlink 2, uplink 2, exciter 2, invalid 1, channel 7, spacecraft 10,"
    "independent 1, reference_2e24_mhz 22, reference_mhz 24, item_20 20, item_21 22, transmitter_delay_ns 22"
)
RAMP = _bits(
    "start_s 32, start_ns 32, rate_hz_s 32, rate_nhz_s 32, frequency_ghz 22, station 10, frequency_hz 32,"
    "frequency_nhz 32, stop_s 32, stop_ns 32"
)
CLOCK = _bits(
    "start_s 32, start_ns 32, offset_s 32, offset_ns 32, station 32, second_station 32, reserved 32,"
    "stop_s 32, stop_ns 32"
)
START_S = 1965098442  # 2012-04-09T04:40:42, from 1950
TWO_WAY = {
    "time_s": START_S,
    "receiver_delay_ns": 77000,
    "observable": -119,
    "observable_1e9": -651956557,
    "format": 2,
    "receiver": 24,
    "transmitter": 24,
    "type": 12,
    "downlink": 1,
    "uplink": 1,
    "exciter": 1,
    "channel": 4,
    "spacecraft": 181,
    "independent": 1,
    "reference_2e24_mhz": 2100062003000 >> 24,
    "reference_mhz": 2100062003000 % 2**24,
    "item_21": 100,
    "transmitter_delay_ns": 77000,
}
"""Count of 1 s in S band."""


def record(bits, values):
    """Return a record of bit fields: negative values in two's complement, missing ones zero."""
    assert set(values) <= set(bits)
    number = 0
    for name, width in bits.items():
        number = (number << width) | (values.get(name, 0) % 2**width)
    return number.to_bytes(36, "big")


def doppler(k, **changes):
    """Return the k-th of counts without gaps."""
    return TWO_WAY | {"time_s": START_S + k, "observable": -119 + 3 * k} | changes


def ramp(station, start_s, stop_s, frequency_hz, rate_hz_s=0):
    """Return a ramp of whole hertz."""
    return {
        "station": station,
        "start_s": start_s,
        "stop_s": stop_s,
        "frequency_ghz": frequency_hz // 10**9,
        "frequency_hz": frequency_hz % 10**9,
        "rate_hz_s": rate_hz_s,
    }


RAMPS = (
    ramp(24, START_S - 600, START_S + 5, 2100062000),
    ramp(24, START_S + 5, START_S + 900, 2100062000, -2),
)


def odf(orbit, ramps=RAMPS, clocks=(), *, label=(181, 1120410, 152917, 19500101, 0), padding=3):
    """Return the bytes of a file with records from dictionaries of their fields."""
    records = []

    def group(key, second, contents, length=1):
        records.append(struct.pack(">iIII20x", key, second, length, len(records)))
        records.extend(contents)

    group(101, 0, [struct.pack(">8s8s5I", b"TDDS    ", b"AMMOS   ", *label)])
    group(107, 0, [b"TIMETAG OBSRVBL FREQ,ANCILLARY-DATA "])
    group(109, 0, [record(ORBIT, row) for row in orbit])
    for station, ramps_of_station in groupby(ramps, key=lambda row: row["station"]):
        group(2030, station, [record(RAMP, row) for row in ramps_of_station])
    if clocks:
        group(2040, 0, [record(CLOCK, row) for row in clocks])
    group(-1, 0, [bytes(36)] * padding, length=0)
    return b"".join(records)


def taken_apart(content):
    """Return records of orbit data and ramps as dictionaries of unsigned fields, read independently of the reader."""
    records = {109: [], 2030: []}
    key = None
    for start in range(0, len(content), 36):
        words = content[start : start + 36]
        if words[16:] == bytes(20):
            [key] = struct.unpack(">i", words[:4])
        elif key in records:
            number, shift = int.from_bytes(words, "big"), 288
            values = {}
            for name, width in (ORBIT if key == 109 else RAMP).items():
                shift -= width
                values[name] = (number >> shift) % 2**width
            records[key].append(values)
    return records[109], records[2030]
