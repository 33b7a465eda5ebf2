"""Opens and evaluates damaged copies of an SPK of each type; to be run by itself, with little memory.

Of each damage it must come to states or to a KernelError. Where SPICE writes past its buffers the process ends, and the
last line printed names the damage.
"""

from __future__ import annotations

import itertools
import resource
import struct
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import spiceypy
from spk_files import ORBITER, circular

from radioloc.ephemeris import Trajectory
from radioloc.errors import KernelError

MEMORY_BYTES = 2 << 30
RECORD = 1024
N, STEP_S = 250, 60.0
ET_S = STEP_S * np.arange(N)
STATES_KM = circular(1.8374e6, 4902.800076e9)(ET_S + 660139200.0) / 1e3
BODY = (ORBITER, 301, "J2000")
SPAN = (*BODY, 0.0, ET_S[-1], "orbit")
VALUES = (-5.0, -1.0, 0.0, 0.5, 1.0, 2.0, 7.0, 28.0, 100.0, 1e4, 1e9, -1e300, float("nan"), float("inf"))


def difference_lines(terms: int, final_s: np.ndarray, directory: list[float]) -> np.ndarray:
    """The words of type 1 or 21: bodies at rest, of 3 orders, at the final epochs."""
    lines = np.zeros((len(final_s), 4 * terms + 11))
    lines[:, 0] = final_s
    lines[:, 1 : 1 + terms] = STEP_S * np.arange(1, terms + 1)
    lines[:, 1 + terms] = 1837.4
    lines[:, -4:] = (4, 3, 3, 3)
    return np.concatenate([lines.ravel(), final_s, final_s[99::100], directory])


def mini_segments() -> np.ndarray:
    """The words of type 19: two mini-segments of type 13's kind."""
    parts = []
    for rows in (slice(0, 126), slice(125, N)):
        epochs = ET_S[rows]
        parts.append(
            np.concatenate([STATES_KM[rows].ravel(), epochs, epochs[99:-1:100], [2, 6, len(epochs)]])
        )
    starts = np.cumsum([1, *(len(part) for part in parts)])
    return np.concatenate([*parts, ET_S[[0, 125, -1]], starts, [1, 2]])


def write(handle: int, spk_type: int) -> None:
    length_s = 7500.0
    series = np.random.default_rng(spk_type).normal(size=(2, 6, 10)) * 1e3
    match spk_type:
        case 2:
            spiceypy.spkw02(handle, *SPAN, length_s, 2, 9, series[:, :3].ravel(), 0.0)
        case 3:
            spiceypy.spkw03(handle, *SPAN, length_s, 2, 9, series.ravel(), 0.0)
        case 5:
            spiceypy.spkw05(handle, *SPAN, 4902.8, N, STATES_KM, ET_S)
        case 8 | 12:
            function = spiceypy.spkw08 if spk_type == 8 else spiceypy.spkw12
            function(handle, *SPAN, 11, N, STATES_KM, 0.0, STEP_S)
        case 9 | 13:
            function = spiceypy.spkw09 if spk_type == 9 else spiceypy.spkw13
            function(handle, *SPAN, 11, N, STATES_KM, ET_S)
        case 14:
            spiceypy.spk14b(handle, "orbit", *BODY, 0.0, ET_S[-1], 9)
            records = np.hstack([[[3750.0, 3750.0], [11250.0, 3750.0]], series.reshape(2, -1)])
            spiceypy.spk14a(handle, 2, records.ravel(), [0.0, length_s])
            spiceypy.spk14e(handle)
        case 15:
            spiceypy.spkw15(
                handle, *SPAN, 0.0, [0, 0, 1], [1, 0, 0], 1837.4, 0.01, 1, [0, 0, 1], 4902.8, 2e-4, 1737.4
            )
        case 17:
            spiceypy.spkw17(
                handle, *SPAN, 0.0, [1837.4, 0.01, 0.01, 0, 0.01, 0.01, 0, 8.8e-4, 0], 0, np.pi / 2
            )
        case 18:
            spiceypy.spkw18(handle, 1, *SPAN, 7, STATES_KM, ET_S)
        case 180:
            packets = np.hstack([STATES_KM, STATES_KM[:, 3:], np.zeros((N, 3))])
            spiceypy.spkw18(handle, 0, *SPAN, 7, packets, ET_S)
        case 20:
            spiceypy.spkw20(handle, *SPAN, 0.1, 2, 6, series[:, :3, :8].ravel(), 1.0, 1.0, 2451545.0, 0.0)


def made(path: Path, spk_type: int) -> bytes:
    """An SPK of one segment; types without a writer have their words put in place of type 13's."""
    handle = spiceypy.spkopn(str(path), "made for a test", 0)
    if spk_type in (1, 19, 21):
        final_s = np.linspace(STEP_S, ET_S[-1], 120)
        words = {
            1: lambda: difference_lines(15, final_s, [120]),
            19: mini_segments,
            21: lambda: difference_lines(25, final_s, [25, 120]),
        }[spk_type]()
        # Written as states of type 8 for the room, then overwritten with its own words and type.
        n = -(-(len(words) - 4) // 6)
        spiceypy.spkw08(handle, *BODY, 0.0, ET_S[-1], "orbit", 7, n, np.zeros((n, 6)), 0.0, ET_S[-1])
        spiceypy.spkcls(handle)
        data = bytearray(path.read_bytes())
        first, _ = addresses(data)
        struct.pack_into("<i", data, summary(data) + 16 + 12, spk_type)
        struct.pack_into("<i", data, summary(data) + 16 + 20, first + len(words) - 1)
        data[(first - 1) * 8 : (first - 1 + len(words)) * 8] = words.astype("<f8").tobytes()
        return bytes(data)
    write(handle, spk_type)
    spiceypy.spkcls(handle)
    return path.read_bytes()


def summary(data: bytes) -> int:
    """Where the first segment's summary is."""
    return (struct.unpack_from("<i", data, 76)[0] - 1) * RECORD + 24


def addresses(data: bytes) -> tuple[int, int]:
    """First and last word of the first segment."""
    return struct.unpack_from("<2i", data, summary(data) + 16 + 16)


def damages(data: bytes) -> Iterator[tuple[str, bytes]]:
    """Damaged copies and what was done to them."""

    def patched(offset: int, layout: str, value: float) -> bytes:
        copy = bytearray(data)
        struct.pack_into("<" + layout, copy, offset, value)
        return bytes(copy)

    first, last = addresses(data)
    for offset in (8, 12, 76, 80, 84):
        for value in (-5, -1, 0, 1, 7, 100, 2**31 - 1):
            yield f"header byte {offset} = {value}", patched(offset, "i", value)
    for offset in range(summary(data) - 24, summary(data) + 16, 8):
        for value in VALUES:
            yield f"list byte {offset} = {value}", patched(offset, "d", value)
    for k in range(6):
        for value in (-5, 0, 1, 2, 13, 19, 100, 100000, 2**31 - 1, last - 1, last + 1):
            yield f"summary integer {k} = {value}", patched(summary(data) + 16 + 4 * k, "i", value)
    rng = np.random.default_rng(5)
    words = {*range(max(first, last - 24), last + 1), *range(first, min(first + 3, last))}
    words |= set(rng.integers(first, last + 1, 40).tolist())
    for word in sorted(words):
        for value in VALUES:
            yield f"word {last - word} before the last = {value}", patched((word - 1) * 8, "d", value)
    for length in (7, 8, 500, 1024, len(data) // 2, len(data) - 8 * 140):
        yield f"cut at {length}", data[:length]
    for at in ((first + 20) * 8, (first + last) * 4, (first + 3) * 8 + 3):
        for n in (8, 48, 3, 1024):
            yield f"{n} bytes lost at {at}", data[:at] + data[at + n :] + bytes(n)
            yield f"{n} bytes put in at {at}", data[:at] + bytes(range(256)) * (n // 256 + 1) + data[at:]
            yield f"spliced at {at}, {n} on", data[:at] + data[at + n : at + n + 4000] + data[at:]


def main(folder: Path, each: int, types: list[int]) -> None:
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
    copy = folder / "damaged.bsp"
    et_s = np.array([0.0, 59.0, 6000.0, 7500.0, 14900.0])
    for spk_type in types:
        data = made(folder / f"type_{spk_type}.bsp", spk_type)
        copy.write_bytes(data)
        source = Trajectory.open(copy, ORBITER)
        assert np.isfinite(source.states(et_s, source.segment_at(et_s))).all()
        refused = n = 0
        for what, damaged in itertools.islice(damages(data), spk_type % each, None, each):
            print(f"type {spk_type}: {what}", flush=True)
            copy.write_bytes(damaged)
            n += 1
            message = ""
            try:
                source = Trajectory.open(copy, ORBITER)
                which = source.segment_at(et_s)
                assert np.isfinite(source.states(et_s[which >= 0], which[which >= 0])).all()
            except KernelError as error:
                message = str(error)
            assert "\n" not in message
            assert not message or "damaged.bsp" in message
            refused += bool(message)
        print(f"type {spk_type} done: {refused} of {n} refused", flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]), [int(text) for text in sys.argv[3:]])
