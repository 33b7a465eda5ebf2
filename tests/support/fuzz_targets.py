"""Targets of the fuzzer beside the readers of tables and texts: recorded results, trials, images, trajectories.

A target is a function that reads and uses a file, a valid file, and the form of damage.
"""

import io
import json
import random
import struct
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from paths import LARGE_DATA
from PIL import Image
from reader_cases import EXAMPLES
from recorded import recorded, reference
from spk_files import ORBITER, write_random

import radioloc
from radioloc.ephemeris import Trajectory
from radioloc.imaging import read_isd
from radioloc.imaging.frames import read_frame, read_mask
from radioloc.io import write_gis, write_spice
from radioloc.io.ccsds import write_oem
from radioloc.jobs.comparison import compare, read_solutions
from radioloc.jobs.trial_folder import TrialFolder
from radioloc.jobs.verification import verify
from radioloc.lunar import Map
from radioloc.report.files import json_text, write_report
from radioloc.report.map_figures import plot_map
from radioloc.results.tables import solution_table
from radioloc.study.map_positions import PlaceOnMap

ISD = Path(__file__).parents[1] / "data" / "isd"
CUBE = LARGE_DATA / "images" / "M143947267L.cal.echo.crop.cub"
SPAN_S = (0.0, 86400.0)
SPK_TYPES = (1, 2, 3, 8, 9, 12, 13, 21)
TRIAL_COLUMNS = ("east_m", "north_m", "converged")

# "@" stands for values that `json` does not write.
JSON_VALUES = (
    *(None, True, False, 0, -1, 1, 2**63, -0.0, 1e300, -1e300, 5e-324, 1e13, float("nan"), float("inf")),
    *("", "nan", "12", "é", "\0", "\x1b[31m", "$x_$", "../x", "ME_DE421", "PA_", "A" * 5000),
    *([], {}, [[]], [None], [1.0, 2.0], [0.0] * 1000, {"": None}, "@digits", "@nesting", "@exponent"),
)
JSON_TEXTS = {"@digits": "9" * 5000, "@nesting": "[" * 100_000 + "]" * 100_000, "@exponent": "1e999999999"}


def _compared(path: Path) -> None:
    comparison = compare([path])
    str(comparison)
    json_text(comparison.to_dict())


def _exported(path: Path) -> None:
    contents = [solution.content for solution in read_solutions(path)[0]]
    solution_table(contents)
    write_gis(path.with_suffix(".geojson"), contents)
    write_spice(path.with_suffix(".bsp"), contents[0], body=301000)
    span = ("2021-03-28T14:00:00", "2021-03-28T15:00:00")
    write_oem(path.with_suffix(".oem"), contents[0], *span, originator="TEST", step_s=600.0)


def _drawn(path: Path) -> None:
    from matplotlib import pyplot

    try:
        plot_map([solution.content for solution in read_solutions(path)[0]])
    finally:
        pyplot.close("all")


def _page(path: Path) -> None:
    write_report(path.parent / "page", compare([path]), html=True)


def _resumed(path: Path) -> None:
    folder = TrialFolder(path.parent / "trials", {}, TRIAL_COLUMNS, (12.0,))
    part = path.parent / "trials" / "parts" / f"linear-{path.name}.npz"
    part.write_bytes(path.read_bytes())
    assert all(values.shape == (1, 3) for values in folder.completed("linear").values())


def _mapped(path: Path) -> None:
    base = Map.open(path)
    base.longitude_latitude_deg([[0.0, 0.0]])


def _flown(path: Path) -> Trajectory:
    return Trajectory.open(path, ORBITER)


def _solution_json(**fields: Any) -> bytes:
    place = reference("map", -51.9, 43.0)
    considered = [{"name": "zenith_delay.A", "unit": "m", "sigma": 0.01, "position_enu_m": [1.0, 2.0, 0.5]}]
    parameter = {"name": "range_bias.A", "unit": "m", "value": 1.0, "sigma": 0.1, "total_sigma": 0.2}
    parts = {"reference": place, "references": [place], "considered": considered}
    return json_text(recorded(**parts | {"parameters": [parameter | {"fixed": False}]} | fields)).encode()


def _place_json() -> bytes:
    ties = [
        {
            "name": f"map_tie.base.{axis}",
            "unit": "m",
            "sigma": 2.0,
            "position_enu_m": [2.0 * k, 2.0 - 2.0 * k, 0.0],
        }
        for k, axis in enumerate(("north", "east"))
    ]
    return _solution_json(method="images", message="", considered=ties)


def _arcs_json() -> bytes:
    arcs = [{"hours": hours, "solution": recorded(f"lander, {hours:g} h")} for hours in (12.0, 24.0)]
    row = {
        "name": "map",
        "method": "reference",
        "longitude_deg": -51.9,
        "latitude_deg": 43.0,
        "height_m": 0.0,
    }
    return json_text({"name": "lander", "positions": [row], "arcs": arcs}).encode()


def _verified_json() -> bytes:
    return json_text(
        radioloc.locate(radioloc.read_study(EXAMPLES / "apollo15" / "apollo15.toml")).to_dict()
    ).encode()


def _trials() -> bytes:
    stream = io.BytesIO()
    np.savez(stream, trials=np.arange(5), values=np.ones((5, 1, 3)), columns=np.array(TRIAL_COLUMNS))
    return stream.getvalue()


def _spk(folder: Path, spk_type: int) -> bytes:
    path = folder / f"random{spk_type}.bsp"
    path.unlink(missing_ok=True)
    return write_random(path, spk_type, [SPAN_S], np.random.default_rng(1)).read_bytes()


def _image(form: str, mode: str, **options: Any) -> bytes:
    """Grey steps as an image of a mode of Pillow: "1" of one bit, "P" of a palette, "I;16" of 16 bits."""
    steps = np.tile(np.arange(64, dtype=np.uint8) * 4, (48, 1))
    deep = mode == "I;16"
    image = Image.fromarray(steps.astype(np.uint16) * 257) if deep else Image.fromarray(steps).convert(mode)
    stream = io.BytesIO()
    image.save(stream, form, **options)
    return stream.getvalue()


def _first_frame() -> bytes:
    return next(iter(sorted((EXAMPLES / "images" / "frames").glob("*.png")))).read_bytes()


TARGETS: dict[str, tuple[Callable[[Path], object], Callable[[Path], bytes], str]] = {
    "solution_compare": (_compared, lambda _: _solution_json(), "json"),
    "solution_export": (_exported, lambda _: _solution_json(), "json"),
    "solution_map": (_drawn, lambda _: _solution_json(), "json"),
    "solution_page": (_page, lambda _: _solution_json(), "json"),
    "solution_verify": (verify, lambda _: _verified_json(), "json"),
    "solution_on_map": (lambda path: PlaceOnMap(path), lambda _: _place_json(), "json"),
    "arcs": (_compared, lambda _: _arcs_json(), "json"),
    "resume": (_resumed, lambda _: _trials(), "npz"),
    "isd_frame": (read_isd, lambda _: (ISD / "synthetic_frame.json").read_bytes(), "json"),
    "isd_lines": (read_isd, lambda _: (ISD / "synthetic_line_scan.json").read_bytes(), "json"),
    "frame": (read_frame, lambda _: _first_frame(), "png"),
    "frame_palette": (read_frame, lambda _: _image("png", "P"), "png"),
    "frame_deep": (read_frame, lambda _: _image("png", "I;16"), "png"),
    "frame_white_is_0": (read_frame, lambda _: _image("tiff", "L", tiffinfo={262: 0}), "bytes"),
    "mask_bit": (read_mask, lambda _: _image("png", "1"), "png"),
    "mask_fax": (read_mask, lambda _: _image("tiff", "1", compression="group4"), "bytes"),
    "mask": (read_mask, lambda _: (EXAMPLES / "images" / "mask.png").read_bytes(), "png"),
    "map": (_mapped, lambda _: (EXAMPLES / "images" / "map.tif").read_bytes(), "bytes"),
}
"""Functions that read and use a file, its valid content, and the form of damage."""
TARGETS |= {f"spk_type_{k}": (_flown, lambda folder, k=k: _spk(folder, k), "bytes") for k in SPK_TYPES}
if CUBE.is_file():
    TARGETS["cube"] = (read_isd, lambda _: CUBE.read_bytes(), "bytes")


def damaged_json(content: bytes, rng: random.Random) -> tuple[str, bytes]:
    """Change one value, key or list of a JSON text; other texts are returned as they are."""
    try:
        top = json.loads(content)
    except (ValueError, RecursionError):
        return "none", content
    holder, key = _place(top, rng)
    if holder is None:
        return "value", _json_of(rng.choice(JSON_VALUES))
    value = holder[key]
    kind = rng.choice(
        ["value", "value", "value", "swap", "remove", "extra", "text", "scale", "length", "wrap"]
    )
    match kind:
        case "value":
            holder[key] = rng.choice(JSON_VALUES)
        case "swap":
            target, target_key = _place(top, rng)
            if target_key not in (None, key):
                copy = json.dumps(target[target_key])
                target[target_key] = (
                    value if not isinstance(value, list | dict) else json.loads(json.dumps(value))
                )
                if key in holder if isinstance(holder, dict) else key < len(holder):
                    holder[key] = json.loads(copy)
        case "remove":
            del holder[key]
        case "extra":
            if isinstance(holder, dict):
                holder[rng.choice(["", "extra", "name", "position", "x_m", "é" * 300])] = rng.choice(
                    JSON_VALUES
                )
            else:
                holder.insert(key, rng.choice(JSON_VALUES))
        case "text":
            holder[key] = str(value)
        case "scale":
            is_number = isinstance(value, int | float) and not isinstance(value, bool)
            holder[key] = value * rng.choice([1e3, -1.0, 1e-3, 1e30, 0.0]) if is_number else [value]
        case "length":
            if isinstance(value, list):
                holder[key] = rng.choice([value[:-1], value * 2, value[:1], [*value, None]])
            else:
                holder[key] = [value] * 3
        case "wrap":
            holder[key] = {"value": value}
    return f"{kind} of {key}", _json_of(top)


def _place(top: Any, rng: random.Random) -> tuple[Any, Any]:
    """Return a container of a tree and a key in it; None for a tree without any."""
    holder, key, value = None, None, top
    while isinstance(value, list | dict) and value and (holder is None or rng.random() < 0.8):
        holder, key = value, rng.choice(list(value) if isinstance(value, dict) else range(len(value)))
        value = holder[key]
    return holder, key


def _json_of(top: Any) -> bytes:
    text = json.dumps(top, ensure_ascii=False)
    for name, replacement in JSON_TEXTS.items():
        text = text.replace(f'"{name}"', replacement)
    return text.encode("utf-8", "surrogatepass")


def damaged_png(content: bytes, rng: random.Random) -> tuple[str, bytes]:
    """Change a header field of a PNG or a byte of any chunk, with its checksum."""
    if content[12:16] != b"IHDR" or len(content) < 33:
        return "none", content
    if rng.random() < 0.4:
        starts = [
            at + 4 for at in (content.find(kind) for kind in (b"IHDR", b"PLTE", b"tRNS", b"IDAT")) if at > 0
        ]
        at = rng.choice(starts)
        end = at + int.from_bytes(content[at - 8 : at - 4], "big")
        if end > at:
            body = bytearray(content[at - 4 : end])
            body[rng.randrange(4, len(body))] = rng.randrange(256)
            check = struct.pack(">I", zlib.crc32(body))
            return f"byte of {bytes(body[:4])!r}", content[: at - 4] + body + check + content[end + 4 :]
    header = list(struct.unpack(">IIBBBBB", content[16:29]))
    k = rng.randrange(7)
    header[k] = rng.choice([0, 1, 2, 3, 8, 16, 255] if k > 1 else [0, 1, 17, 32000, 100_000, 2**31 - 1])
    if k < 2 and rng.random() < 0.5:
        header[1 - k] = header[k]
    chunk = b"IHDR" + struct.pack(">IIBBBBB", *header)
    return f"header {header}", content[:12] + chunk + struct.pack(">I", zlib.crc32(chunk)) + content[33:]


def damaged_npz(content: bytes, rng: random.Random) -> tuple[str, bytes]:
    """Exchange a member of an archive of arrays by one of another type, shape or size."""
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            members = {name: archive.read(name) for name in archive.namelist()}
        name = rng.choice(list(members))
    except (
        zipfile.BadZipFile,
        IndexError,
        zlib.error,
        RuntimeError,
        NotImplementedError,
        OSError,
        ValueError,
    ):
        return "none", content
    kind = rng.choice(["shape", "type", "zeros", "lose", "extra", "object", "value", "empty"])
    shapes = [(10**12,), (0,), (), (5,), (-1,), (2**62, 4), (5, 1, 10**9), (5, 10**9, 0), (1,) * 40]
    match kind:
        case "shape":
            members[name] = _npy("<f8", rng.choice(shapes)) + members[name][-120:]
        case "type":
            types = ["<U3", "|O", "<c16", "|b1", "<M8[s]", "<U1000000000", "|V7", "<i8", "<f4", ">f8"]
            members[name] = _npy(rng.choice(types), rng.choice([(5,), (5, 1, 3), (3,)])) + bytes(500)
        case "zeros":
            members[name] = _npy("<f8", (10_000_000,)) + bytes(80_000_000)
        case "lose":
            del members[name]
        case "extra":
            members[rng.choice(["x.npy", "../x.npy", "trials", ""])] = members[name]
        case "object":
            members[name] = _npy("|O", (5,)) + b"\x80\x04]\x94."
        case "value":
            values = rng.choice(
                [[np.nan] * 5, [-1] * 5, [1, 1, 1, 1, 1], [1e300] * 5, ["a"] * 5, [2**63] * 5]
            )
            stream = io.BytesIO()
            np.save(stream, np.array(values))
            members[name] = stream.getvalue()
        case "empty":
            members[name] = b""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", rng.choice([zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED])) as archive:
        for member, data in members.items():
            archive.writestr(member or "_", data)
    return f"{kind} of {name}", stream.getvalue()


def _npy(kind: str, shape: tuple[int, ...]) -> bytes:
    header = repr({"descr": kind, "fortran_order": False, "shape": shape}).encode()
    header += b" " * (-(len(header) + 11) % 64) + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header


AFTER_READING = ("solution_export", "solution_map", "solution_page")
"""Targets that also write or draw, whose errors need not name the file."""

STRUCTURED = {"json": damaged_json, "png": damaged_png, "npz": damaged_npz}
"""Damage that keeps the form of a file, by form."""
