"""Truncated maps, which GDAL reads without complaint: without their scale, or with zeros for what is missing."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from radioloc.errors import FileFormatError

_TYPE_BYTES = dict(
    zip((*range(1, 14), 16, 17, 18), (1, 1, 2, 4, 8, 1, 1, 2, 4, 8, 4, 8, 4, 8, 8, 8), strict=True)
)
"""Bytes of a value of each type of TIFF 6.0 and BigTIFF."""


def refuse_cut_map(path: Path, dataset: Any) -> None:
    """Raise :class:`~radioloc.errors.FileFormatError` if a map that GDAL has opened is only part of its file."""
    with path.open("rb") as stream:
        if dataset.driver == "GTiff":
            needed = _tiff_bytes(stream)
        elif dataset.driver == "ENVI" and stream.read(2) != b"\x1f\x8b":
            cells = dataset.width * dataset.height * np.dtype(dataset.dtypes[0]).itemsize
            needed = cells + int(dataset.tags(ns="ENVI").get("header_offset", 0))
        else:
            return
    held = path.stat().st_size
    if held < needed:
        raise FileFormatError(
            path, f"was cut: it has {held} bytes of at least {needed} that it announces; fetch it again"
        )


def _tiff_bytes(stream: BinaryIO) -> int:
    """How long a TIFF file has to be to hold the values of all its tags.

    Where the last of them are lost, among them GDAL's scale and unit, they are left aside with a warning in a log.
    """
    order = {b"II": "<", b"MM": ">"}.get(stream.read(2), "<")
    big = _numbers(stream, order + "H") == (43,)
    if big:
        stream.seek(8)
    count_format, entry_format, offset_format = ("Q", "HHQ", "Q") if big else ("H", "HHI", "I")
    needed, seen = 0, set[int]()
    (directory,) = _numbers(stream, order + offset_format) or (0,)
    while directory and directory not in seen:
        seen.add(directory)
        stream.seek(directory)
        (count,) = _numbers(stream, order + count_format) or (0,)
        for _ in range(count):
            entry = _numbers(stream, order + entry_format)
            place = _numbers(stream, order + offset_format)
            if not entry or not place:
                return max(needed, stream.tell() + 1)
            length = _TYPE_BYTES.get(entry[1], 1) * entry[2]
            if length > struct.calcsize(offset_format):
                needed = max(needed, place[0] + length)
        (directory,) = _numbers(stream, order + offset_format) or (0,)
    return needed


def _numbers(stream: BinaryIO, form: str) -> tuple[int, ...]:
    """Next numbers of a file, none where it ends."""
    content = stream.read(struct.calcsize(form))
    return struct.unpack(form, content) if len(content) == struct.calcsize(form) else ()
