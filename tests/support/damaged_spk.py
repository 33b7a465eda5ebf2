"""Opens and evaluates damaged copies of an SPK of each type; to be run by itself, with little memory.

Each damage must end in finite states or in a KernelError. The last line printed names the damage.
"""

from __future__ import annotations

import itertools
import resource
import struct
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from spk_files import ORBITER, TYPES, write_random

from radioloc.ephemeris import Trajectory
from radioloc.errors import KernelError

MEMORY_BYTES = 2 << 30
RECORD = 1024
SPAN_S = (0.0, 15000.0)
VALUES = (-5.0, -1.0, 0.0, 0.5, 1.0, 2.0, 7.0, 28.0, 100.0, 1e4, 1e9, -1e300, float("nan"), float("inf"))


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
    endless = bytearray(patched(84, "i", 2**31 - 1))
    struct.pack_into("<d", endless, summary(data) - 24, summary(data) // RECORD + 1)
    yield "circular list of a file that is cut", bytes(endless[:4096])
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
    for length in (7, 8, 500, 1024, len(data) // 2, *range(len(data) - 200, len(data))):
        yield f"cut at {length}", data[:length]
    for at in ((first + 20) * 8, (first + last) * 4, (first + 3) * 8 + 3):
        for n in (8, 48, 3, 1024):
            yield f"{n} bytes lost at {at}", data[:at] + data[at + n :] + bytes(n)
            yield f"{n} bytes put in at {at}", data[:at] + bytes(range(256)) * (n // 256 + 1) + data[at:]
            yield f"spliced at {at}, {n} on", data[:at] + data[at + n : at + n + 4000] + data[at:]


def main(folder: Path, each: int) -> None:
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
    copy = folder / "damaged.bsp"
    et_s = np.array([0.0, 59.0, 6000.0, 7500.0, 14900.0])
    for spk_type in TYPES:
        data = write_random(
            folder / f"sound_{spk_type}.bsp", spk_type, [SPAN_S], np.random.default_rng(1)
        ).read_bytes()
        copy.write_bytes(data)
        sound = Trajectory.open(copy, ORBITER).states(et_s, np.zeros(5, dtype=int))
        assert np.isfinite(sound).all()
        refused = n = 0
        for what, damaged in itertools.islice(damages(data), spk_type % each, None, each):
            print(f"type {spk_type}: {what}", flush=True)
            copy.write_bytes(damaged)
            n += 1
            message = ""
            try:
                source = Trajectory.open(copy, ORBITER)
                which = source.segment_at(et_s)
                states = source.states(et_s[which >= 0], which[which >= 0])
                assert np.isfinite(states).all()
                assert not what.startswith("cut") or np.array_equal(states, sound)  # only the filling is cut
            except KernelError as error:
                message = str(error)
            assert "\n" not in message
            assert not message or "damaged.bsp" in message
            refused += bool(message)
            assert message or "circular" not in what
        print(f"type {spk_type} done: {refused} of {n} refused", flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]))
