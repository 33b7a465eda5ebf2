"""Kernels with several segments of a body against SPICE: of those for an epoch the last one of the file counts."""

import numpy as np
import pytest
import spiceypy
from moon_frame import PA_FRAME
from spk_files import with_other_byte_order

from radioloc.ephemeris import Ephemeris, LunarOrientation, Trajectory
from radioloc.errors import CoverageError, KernelError
from radioloc.kernels.files import add_kernel, open_kernel
from radioloc.time import Epochs

DAY_S = 86400.0
START_S = -30.0 * 365.25 * DAY_S  # 1970-01-01
# First and last day, and what is added to the constant term of each series; in the file's order.
PIECES = [(0, 2000, 0.0), (2000, 4000, 1.0), (4500, 6000, 2.0), (1000, 1500, 3.0), (3900, 4100, 4.0)]
SPANS = [(0, 4100), (4500, 6000)]


def write_pieces(path, kernel, scale, write, pieces=PIECES):
    """Write the series of a kernel that ships in pieces, distinguished by offsets."""
    spk = kernel.file.kind == "SPK"
    handle = (spiceypy.spkopn if spk else spiceypy.pckopn)(str(path), "pieces", 0)
    for first_day, last_day, offset in pieces:
        first_s, last_s = START_S + first_day * DAY_S, START_S + last_day * DAY_S
        for segment in kernel.segments:
            length_s = segment.record_length_s
            k = int((first_s - segment.first_record_s) // length_s)
            n = int(np.ceil((last_s - segment.first_record_s) / length_s)) - k
            series = np.array(segment.coefficients[k : k + n])
            series[:, :, 0] += scale * offset
            codes = (segment.target, segment.center, "J2000") if spk else (segment.target, "J2000")
            degree, first_record_s = series.shape[-1] - 1, segment.first_record_s + k * length_s
            write(
                handle,
                *codes,
                first_s,
                last_s,
                segment.name,
                length_s,
                n,
                degree,
                series.ravel(),
                first_record_s,
            )
    (spiceypy.spkcls if spk else spiceypy.pckcls)(handle)
    return path


def days_within_spans(rng):
    """Days inside the spans, with all ends of pieces."""
    days = np.concatenate([rng.uniform(*span, 400) for span in SPANS])
    return np.append(np.round(days * DAY_S) / DAY_S, [piece[:2] for piece in PIECES])


@pytest.mark.parametrize("big_endian", [False, True])
def test_ephemeris_of_several_segments_is_that_of_spice(tmp_path, big_endian):
    path = write_pieces(tmp_path / "pieces.bsp", open_kernel("DE421", "SPK"), 10.0, spiceypy.spkw02)
    if big_endian:
        path.write_bytes(with_other_byte_order(path.read_bytes()))
    ephemeris = Ephemeris.open(path)
    et_s = START_S + DAY_S * days_within_spans(np.random.default_rng(3))
    tdb = Epochs.from_tdb_seconds(et_s)
    spiceypy.furnsh(str(path))
    try:
        by_spice = {
            body: 1e3 * np.array([spiceypy.spkgeo(code, et, "J2000", 399)[0] for et in et_s])
            for body, code in (("moon", 301), ("sun", 10))
        }
    finally:
        spiceypy.kclear()
    for body, tolerance_m in (("moon", 1e-6), ("sun", 2e-4)):
        position_m, velocity_m_s = ephemeris.geocentric(body, tdb)
        np.testing.assert_allclose(position_m, by_spice[body][:, :3], rtol=0, atol=tolerance_m)
        np.testing.assert_allclose(velocity_m_s, by_spice[body][:, 3:], rtol=0, atol=1e-9)
    moon = Trajectory.open(path, 301)
    assert moon.spans_s() == [(START_S + a * DAY_S, START_S + b * DAY_S) for a, b in SPANS]
    np.testing.assert_allclose(moon.geocentric(ephemeris, tdb)[0], by_spice["moon"][:, :3], rtol=0, atol=1e-6)


def test_orientation_of_several_segments_is_that_of_spice(tmp_path):
    path = write_pieces(tmp_path / "pieces.bpc", open_kernel("DE421", "PCK"), 1e-3, spiceypy.pckw02)
    et_s = START_S + DAY_S * days_within_spans(np.random.default_rng(4))
    angles_rad, rates_rad_s = LunarOrientation.open(path).angles(Epochs.from_tdb_seconds(et_s))
    spiceypy.furnsh(str(path))
    spiceypy.lmpool(PA_FRAME.split("\n")[2:-2])
    try:
        by_spice = np.array([spiceypy.sxform("J2000", "MOON_PA_DE421", et) for et in et_s])
    finally:
        spiceypy.kclear()
    ours = np.array(
        [
            spiceypy.eul2xf([*angles[::-1], *rates[::-1]], 3, 1, 3)
            for angles, rates in zip(angles_rad, rates_rad_s, strict=True)
        ]
    )
    np.testing.assert_allclose(ours, by_spice, rtol=0, atol=1e-11)


def test_span_is_the_union_and_gaps_are_refused_by_name(tmp_path, monkeypatch):
    path = write_pieces(tmp_path / "pieces.bsp", open_kernel("DE421", "SPK"), 0.0, spiceypy.spkw02)
    ephemeris = Ephemeris.open(path)
    assert (ephemeris.kernel.start_tdb, ephemeris.kernel.end_tdb) == ("1970-01-01", "1986-06-06")
    within_gap = Epochs.from_tdb_seconds(START_S + DAY_S * np.array([100.0, 4300.0]))
    with pytest.raises(CoverageError, match=r"pieces\.bsp.*\(1970-01-01.*1981-03-24") as caught:
        ephemeris.geocentric("moon", within_gap)
    assert caught.value.requested == ("1981-10-10T00:00:00.000 TDB",) * 2
    monkeypatch.setenv("RADIOLOC_KERNELS", str(tmp_path / "added"))
    assert add_kernel(path).end_tdb == "1986-06-06"


def test_segments_of_several_ephemerides_need_constants(tmp_path):
    kernel, kernel_440 = open_kernel("DE421", "SPK"), open_kernel("DE440", "SPK")
    path = tmp_path / "mixed.bsp"
    write_pieces(path, kernel, 0.0, spiceypy.spkw02, [(0, 2000, 0.0)])
    handle = spiceypy.spkopa(str(path))
    segment = kernel_440.segments_of(399, 3)[-1]
    first_s = segment.first_record_s
    spiceypy.spkw02(
        handle, 399, 3, "J2000", first_s, first_s + segment.record_length_s, segment.name, segment.record_length_s, 1,
        segment.coefficients.shape[-1] - 1, np.array(segment.coefficients[:1]).ravel(), first_s,
    )  # fmt: skip
    spiceypy.spkcls(handle)
    with pytest.raises(KernelError, match=r"mixed\.bsp.*'DE-0421LE-0421, DE-0440LE-0440'"):
        Ephemeris.open(path)


def test_a_body_in_another_type_of_segment_too_is_refused(tmp_path):
    path = write_pieces(
        tmp_path / "pieces.bsp", open_kernel("DE421", "SPK"), 0.0, spiceypy.spkw02, [(0, 2000, 0.0)]
    )
    handle = spiceypy.spkopa(str(path))
    et_s = START_S + DAY_S * np.arange(10.0)
    spiceypy.spkw13(handle, 301, 3, "J2000", et_s[0], et_s[-1], "later", 3, 10, np.ones((10, 6)), et_s)
    spiceypy.spkcls(handle)
    with pytest.raises(KernelError, match=r"NAIF.*301.*3.*2.*13"):
        Ephemeris.open(path)
