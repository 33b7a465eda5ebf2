"""Give every reader damaged copies of valid files, in processes that may end or exhaust their memory.

    fuzz_readers.py FOLDER SEED SECONDS [TARGET ...]

runs each target, all of them by default, in a process of its own, SECONDS in all, and prints the counts and failures of
each. A process that ends or hangs is a failure, and another one goes on with the next seed.

The outcome must be a result or a RadiolocError: one printable line of some hundred characters that names the file.
Damage follows the structure of files: exchanged fields, extreme numbers, lost, repeated and moved lines and blocks,
parts of other files, other encodings. The last line printed names the damage that ended a process; the damaged file is
kept.
"""

import gzip
import logging
import os
import random
import re
import resource
import signal
import struct
import subprocess
import sys
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
from atmosphere_files import orography_text, vmf3_map_text
from fuzz_targets import AFTER_READING, STRUCTURED, TARGETS
from numpy.typing import ArrayLike
from odf_files import doppler, odf
from reader_cases import BINARIES, EXAMPLES, SEGMENTS, TABLE, TEXTS
from tdm_messages import kvn, xml
from terrain_maps import write_pds3

from radioloc.errors import RadiolocError, RadiolocWarning
from radioloc.io.table import read_table, write_parquet
from radioloc.kernels import find_kernel
from radioloc.time import Epochs, epochs_from_strings

MEMORY_BYTES = 1 << 30  # beyond the memory at the start of reading
LONGEST_S = 20
LONGEST_START_S = 120  # of a process on a busy machine, and its last file
LONGEST_MESSAGE = 800
EXTREMES = (
    *("nan", "inf", "-1", "0", "1e999", "1e300", "-1e-300", "1e-300", "9" * 25, "9" * 5000, "-900", "30"),
    *("1e18", "", "0x10", "1_0", "na", "²", "١٢", "2021-03-28T14:00:00", "1e-999", "2147483648"),
    *("-9223372036854775809", "0.1234567890123456789012345", "A" * 500, "\U0001f600", "é", "\x7f", "\0"),
    *("[" * 3000, "'", '"', "\\", "%s", "{0}", "00", "1.5", "-1.5e3", "366", "60", "61", "24:00:00"),
    *("1972-01-01", "9999-12-31", "0001-01-01", "UTC", "true"),
)
ALL = sorted({*BINARIES, *TEXTS, "pds3", *TARGETS})
NOON = Epochs.from_jd(2460310.5, 0.0, "UTC")
NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")
FIELD = re.compile(r"[^\s,=<>:;\"'\[\](){}]+")
WORDS = (-1, 0, 1, 2, 5, 100, 2**15, 2**31 - 1, -(2**31))
DOUBLES = (float("nan"), float("inf"), -1.0, 0.0, 1e300, -1e300, 1e-300, 100.0, 5e8)


def replaced(text: str, pattern: re.Pattern[str], by: Callable[[str], str], rng: random.Random) -> str:
    """Replace one match within some thousand characters of a text."""
    start = rng.randrange(max(1, len(text) - 4000)) if rng.random() < 0.3 else 0
    matches = list(pattern.finditer(text, start, start + 8000))
    if not matches:
        return text
    match = rng.choice(matches)
    return text[: match.start()] + by(match[0]) + text[match.end() :]


def damaged_text(text: str, contents: list[bytes], rng: random.Random) -> tuple[str, bytes]:
    lines = text.split("\n")
    k, m = rng.randrange(len(lines)), rng.randrange(len(lines))
    kinds = "number number number scaled field swap lose repeat move insert encode bytes"
    kind = rng.choice(kinds.split())
    match kind:
        case "number":
            text = replaced(text, NUMBER, lambda _: rng.choice(EXTREMES), rng)
        case "scaled":
            factor = rng.choice([1e3, 1e-3, 100.0, -1.0, 10.0, 1e30])
            text = replaced(text, NUMBER, lambda number: f"{float(number) * factor:g}", rng)
        case "field":
            text = replaced(text, FIELD, lambda _: rng.choice(EXTREMES), rng)
        case "swap":
            fields: list[str] = []
            replaced(text, FIELD, lambda field: fields.append(field) or field, rng)
            text = replaced(text, FIELD, lambda _: "".join(fields), rng)
        case "lose":
            del lines[min(k, m) : min(k, m) + rng.choice([1, 1, 2, 10, len(lines)])]
            text = "\n".join(lines)
        case "repeat":
            text = "\n".join(
                lines[:k] + lines[k : k + rng.choice([1, 2, 20])] * rng.choice([2, 2, 3, 500]) + lines[k:]
            )
        case "move":
            lines[k], lines[m] = lines[m], lines[k]
            text = "\n".join(lines)
        case "insert":
            place = rng.randrange(len(text) + 1)
            text = (
                text[:place]
                + rng.choice(["\0", ",", "\n", "\r", "\t", "<", "&", "#", '"', "ü", "="])
                + text[place:]
            )
        case "encode":
            encoding = rng.choice(["utf-16", "utf-16-le", "utf-32", "utf-8-sig", "cp037", "utf-7"])
            return f"{kind} {encoding}", text.encode(encoding, "replace")
        case "bytes":
            return damaged_bytes(text.encode(), contents, rng)
    return kind, text.encode("utf-8", "surrogatepass")


def damaged_bytes(data: bytes, contents: list[bytes], rng: random.Random) -> tuple[str, bytes]:
    copy = bytearray(data)
    # Headers are at the start or at the end; the middle is mostly numbers.
    reach = rng.choice([64, 1024, 4096, len(data)])
    place = rng.randrange(min(reach, len(data)))
    place = place if rng.random() < 0.6 else len(data) - 1 - place
    kind = rng.choice(
        ["flip", "flip", "integer", "double", "cut", "lose", "splice", "insert", "gzip", "gzip cut"]
    )
    match kind:
        case "flip":
            for _ in range(rng.choice([1, 1, 4, 40])):
                copy[rng.randrange(len(copy)) if rng.random() < 0.5 else place] = rng.randrange(256)
        case "integer":
            form = rng.choice("<>") + rng.choice("bhiq")
            value = rng.choice(WORDS)
            size = struct.calcsize(form)
            value = max(-(2 ** (8 * size - 1)), min(2 ** (8 * size - 1) - 1, value))
            place -= place % size
            copy[place : place + size] = struct.pack(form, value)
        case "double":
            place -= place % 8
            copy[place : place + 8] = struct.pack("<d", rng.choice(DOUBLES))
        case "cut":
            del copy[place:]
        case "lose":
            del copy[place : place + rng.choice([1, 2, 8, 100, 1024])]
        case "splice":
            source = rng.choice([data, *contents])
            start = rng.randrange(len(source))
            copy[place:] = source[start : start + 2_000_000]
        case "insert":
            copy[place:place] = rng.randbytes(rng.choice([1, 2, 8, 1024]))
        case "gzip":
            copy = bytearray(gzip.compress(bytes(copy), 1))
        case "gzip cut":
            packed = gzip.compress(bytes(copy), 1)
            copy = bytearray(packed[: rng.randrange(len(packed))])
    return f"{kind} at {place}", bytes(copy)


def cases(folder: Path) -> dict[str, tuple[Callable[[Path], object], bytes]]:
    """Return readers by name, with the content of a valid file."""
    (folder / "orography").write_text(orography_text())
    (folder / "map").write_text(vmf3_map_text(0))
    (folder / "table").write_text(TABLE)
    write_parquet(folder / "rows", read_table(folder / "table"))
    (folder / "orbit_data").write_bytes(odf([doppler(k) for k in range(9)]))
    pds3 = {"projection": "SIMPLE CYLINDRICAL", "map_scale": "151616.75 <m/pix>"}
    write_pds3(folder, np.add.outer(np.arange(36) * 10.0, np.arange(72) * 30.0), **pds3)
    readers = {name: (read, text.encode()) for name, (read, text) in TEXTS.items()}
    binaries = {
        "spk": find_kernel("DE421", "SPK"),
        "pck": find_kernel("DE421", "PCK"),
        "trajectory": EXAMPLES / "orbiter" / "orbiter.bsp",
        "terrain": EXAMPLES / "change5" / "ldem_4_landing_site.tif",
        "parquet": folder / "rows",
        "odf": folder / "orbit_data",
    }
    readers |= {name: (BINARIES[name], path.read_bytes()) for name, path in binaries.items()}
    readers["pds3"] = (BINARIES["terrain"], (folder / "MAP.LBL").read_bytes())
    readers["tdm"] = (TEXTS["tdm"][0], "\n".join(kvn(*SEGMENTS)).encode())
    readers["tdm_xml"] = (TEXTS["tdm_xml"][0], xml(*SEGMENTS).encode())
    return readers


@contextmanager
def limited() -> Iterator[None]:
    """Limit additional memory and time."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    limit = pages * resource.getpagesize() + MEMORY_BYTES
    previous = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (limit, previous[1]))
    signal.alarm(LONGEST_S)
    try:
        yield
    finally:
        signal.alarm(0)
        resource.setrlimit(resource.RLIMIT_AS, previous)


def used(name: str, result: Any) -> ArrayLike:
    """Return numbers from a result, which must be finite."""
    match name:
        case "terrain":
            return result.height_and_slope(*np.radians([-51.9, 43.1]))
        case "pds3":
            return result.height_and_slope([0.1, 3.0], [0.2, -1.0])
        case "ionex":
            return result.vertical_tec(
                [0.1, 1.0], [0.2, 3.0], epochs_from_strings(["2019-01-15T00:30:00"] * 2, "UTC")
            )
        case "blq":
            return [site.amplitude_m for site in result.values()]
        case "eop":
            return result.interpolate(Epochs.from_jd(2458851.5, 0.2, "TT")).ut1_minus_tt_s
        case "gpt3":
            return result.values_at(NOON, 0.8, 0.2, 500.0).pressure_hpa
        case "vmf3_grids" | "orography":
            return result.values_at(NOON, 0.8, 0.2, 500.0).zenith_wet_m
        case "vmf3_sites":
            return np.concatenate([site.values for site in result.values()])
        case _ if name == "trajectory" or name.startswith("spk_type"):
            et_s = np.concatenate([np.linspace(*span, 7) for span in result.spans_s()[:20]])
            segment = result.segment_indices(et_s)
            return result.states(et_s[segment >= 0], segment[segment >= 0])
        case "crd" | "mini" | "table" | "observations" | "tdm" | "tdm_xml" | "parquet" | "odf":
            assert len(result) > 0
            assert (result.sigma_m > 0.0).all()
            assert ((result.epoch.fraction >= 0.0) & (result.epoch.fraction < 1.0)).all()
            return result.value_m
    return 0.0


def is_refused(name: str, read: Callable[[Path], object], path: Path) -> bool:
    """Return True if a reader refuses a file; other errors are raised."""
    try:
        with limited():
            result = read(path)
            with suppress(RadiolocError):  # these errors need not name the file
                assert np.isfinite(used(name, result)).all()
    except RadiolocError as error:
        message = str(error)
        assert path.name in message or name in AFTER_READING, f"does not name the file: {message[:1000]}"
        assert message.isprintable(), f"is not printable: {message!r}"
        assert len(message) - len(str(path)) < LONGEST_MESSAGE, (
            f"is {len(message)} characters long: {message[:3000]}"
        )
        return True
    return False


def damage(name: str, content: bytes, contents: list[bytes], rng: random.Random) -> tuple[str, bytes]:
    """Return the kind of a single damage, and the damaged content."""
    form = TARGETS[name][2] if name in TARGETS else "text" if name in TEXTS or name == "pds3" else "bytes"
    if form in STRUCTURED and rng.random() < 0.8:
        return STRUCTURED[form](content, rng)
    if form in ("text", "json") and rng.random() < 0.9:
        return damaged_text(content.decode("utf-8", "replace") or " ", contents, rng)
    return damaged_bytes(content or b" ", contents, rng)


def run_target(name: str, folder: Path, seed: int, seconds: float) -> None:
    """Read damaged copies of one valid file; print each damage and each outcome."""
    if name in TARGETS:
        read, make, _ = TARGETS[name]
        content = make(folder)
        contents = [content]
    else:
        readers = cases(folder)
        read, content = readers[name]
        contents = [content for _, content in readers.values() if len(content) < 2_000_000]
    rng = random.Random(f"{seed} {name}")
    path = folder / f"given.{name}"
    path.write_bytes(content)
    assert not is_refused(name, read, path), name
    print("sound", flush=True)
    failures_seen: set[str] = set()
    count, until = 0, time.monotonic() + seconds
    while time.monotonic() < until or count < 3:
        damages, damaged = [], content
        for _ in range(rng.choice([1, 1, 1, 2, 3])):
            kind, damaged = damage(name, damaged, contents, rng)
            damages.append(kind)
        path.write_bytes(damaged)
        print(f"damage: {', '.join(damages)!r:.300}", flush=True)
        try:
            print("refused" if is_refused(name, read, path) else "read", flush=True)
        except Exception as error:
            frames = traceback.extract_tb(error.__traceback__)
            frame = next((f for f in reversed(frames) if "/radioloc/" in f.filename), frames[-1])
            failure = f"{type(error).__name__} at {Path(frame.filename).name}:{frame.lineno}"
            if failure not in failures_seen:
                failures_seen.add(failure)
                copy = folder / f"failed.{name}.{seed}.{count}"
                copy.write_bytes(damaged)
                print(
                    f"FAILED {failure}, {copy} ({', '.join(damages)[:200]}): {str(error)[:300]!r}", flush=True
                )
            else:
                print("failed again", flush=True)
        count += 1
    print(f"{name} done", flush=True)


def watch_target(name: str, folder: Path, seed: int, seconds: float) -> tuple[Counter[str], list[str]]:
    """Run a target in separate processes until its time is over; return counts and failures."""
    counts: Counter[str] = Counter()
    failures: list[str] = []
    until = time.monotonic() + seconds
    while True:
        remaining_s = max(until - time.monotonic(), 0.0)
        command = [sys.executable, __file__, "--target", name, folder, str(seed), str(remaining_s)]
        log = folder / f"log.{name}"
        with log.open("wb") as stream:
            try:
                status = subprocess.run(
                    command, stdout=stream, stderr=subprocess.STDOUT, timeout=remaining_s + LONGEST_START_S
                )
                ended = f"exit status {status.returncode}"
            except subprocess.TimeoutExpired:
                ended = "hangs"
        lines = log.read_text("utf-8", "replace").splitlines()
        counts["files"] += sum(line.startswith("damage: ") for line in lines)
        counts["refused"] += lines.count("refused")
        counts["failures"] += sum(line.startswith(("FAILED", "failed again")) for line in lines)
        failures += [f"{name}: {line}" for line in lines if line.startswith("FAILED")]
        if lines[-1:] == [f"{name} done"]:
            return counts, failures
        counts["failures"] += 1
        path, copy = folder / f"given.{name}", folder / f"ended.{name}.{seed}"
        if path.is_file():
            path.replace(copy)
        last = [line for line in lines if line.startswith("damage")][-1:]
        failures.append(f"{name}: {ended}, {copy}, {last}: {' / '.join(lines[-4:])[-600:]}")
        if "sound" not in lines or time.monotonic() > until:
            return counts, failures
        seed += 1000


def main(folder: Path, seed: int, seconds: float, names: list[str]) -> None:
    """Run targets one after the other, each with its part of the time, and print the outcomes."""
    folder.mkdir(parents=True, exist_ok=True)
    os.environ["PYTHONPATH"] = os.pathsep.join(sys.path)
    names = names or ALL
    total: Counter[str] = Counter()
    for name in names:
        counts, failures = watch_target(name, folder, seed, seconds / len(names))
        print(
            f"{name:20} {counts['files']:8} files {counts['refused']:8} refused {counts['failures']:4} failures",
            flush=True,
        )
        print("".join(f"{line}\n" for line in failures), end="", flush=True)
        total += counts
    print(f"{'all':20} {total['files']:8} files {total['refused']:8} refused {total['failures']:4} failures")
    sys.exit(1 if total["failures"] else 0)


if __name__ == "__main__":
    if sys.argv[1] == "--target":  # or several, separated by commas, in this process
        logging.getLogger("rasterio").setLevel(logging.CRITICAL)
        warnings.simplefilter("error")
        warnings.simplefilter("ignore", RadiolocWarning)
        targets = sys.argv[2].split(",")
        for target in targets:
            run_target(target, Path(sys.argv[3]), int(sys.argv[4]), float(sys.argv[5]) / len(targets))
    else:
        main(Path(sys.argv[1]), int(sys.argv[2]), float(sys.argv[3]), sys.argv[4:])
