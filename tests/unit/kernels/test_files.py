import shutil
import struct
from functools import partial

import numpy as np
import pytest
from spk_files import with_other_byte_order

from radioloc.errors import KernelError
from radioloc.kernels import find_kernel, registered
from radioloc.kernels.daf import tdb_date
from radioloc.kernels.files import open_kernel, sha256_of

SPK_PATH = find_kernel("DE421", "SPK")
PCK_PATH = find_kernel("DE421", "PCK")
PCK_BYTES = PCK_PATH.read_bytes()
SUMMARY = (struct.unpack_from("<i", PCK_BYTES, 76)[0] - 1) * 1024
FIRST_WORD, LAST_WORD = struct.unpack_from("<2i", PCK_BYTES, SUMMARY + 24 + 16 + 12)
FIRST_BYTE, LAST_BYTE = (FIRST_WORD - 1) * 8, LAST_WORD * 8

open_spk, open_pck = (partial(open_kernel, kind=kind) for kind in ("SPK", "PCK"))


def written(tmp_path, data, name="own.bpc"):
    path = tmp_path / name
    path.write_bytes(bytes(data))
    return path


def test_kernels_that_ship():
    for kernel in (open_spk("DE421"), open_pck("DE421")):
        entry = next(e for e in registered() if e.kind == kernel.file.kind)
        assert kernel.file.registered
        assert kernel.file.sha256 == entry.sha256
        assert [s.target for s in kernel.segments] == list(entry.bodies)
        assert (kernel.file.start_tdb, kernel.file.end_tdb) == ("1969-01-01", "2050-01-01")
        assert all(
            (tdb_date(s.start_s), tdb_date(s.end_s)) == ("1969-01-01", "2050-01-01") for s in kernel.segments
        )


def test_own_file_is_opened_with_its_checksum(tmp_path):
    copy = tmp_path / "own.bsp"
    shutil.copy(SPK_PATH, copy)
    kernel = open_spk(copy)
    assert not kernel.file.registered
    assert kernel.file.sha256 == sha256_of(copy)
    np.testing.assert_array_equal(
        kernel.segments_of(301, 3)[-1].coefficients, open_spk("DE421").segments_of(301, 3)[-1].coefficients
    )


@pytest.mark.parametrize("offset", [100, 1500, FIRST_BYTE + 1000, LAST_BYTE - 5])
def test_a_flipped_byte_in_a_kernel_that_ships(tmp_path, offset):
    data = bytearray(PCK_BYTES)
    data[offset] ^= 0x10
    path = written(tmp_path, data, PCK_PATH.name)
    with pytest.raises(KernelError, match=r"de421_1969_2050\.bpc \(spanning 1969-01-01.*2050-01") as caught:
        open_pck(path)
    assert sha256_of(path) in str(caught.value)


@pytest.mark.parametrize(
    "length", [8, 500, 1024, 2048, SUMMARY + 100, SUMMARY + 1024, FIRST_BYTE + 8, LAST_BYTE - 8]
)
def test_cut_short(tmp_path, length):
    with pytest.raises(KernelError, match=r"own\.bpc (\(spanning .*\) )?is (damaged|cut short)"):
        open_pck(written(tmp_path, PCK_BYTES[:length]))


def patched(offset, layout, *values):
    data = bytearray(PCK_BYTES)
    struct.pack_into("<" + layout, data, offset, *values)
    return data


@pytest.mark.parametrize(
    ("offset", "layout", "values", "message"),
    [
        (12, "i", (6,), "wrong layout"),
        (SUMMARY, "d", (SUMMARY / 1024 + 1,), "runs in a circle"),
        (SUMMARY, "d", (float("inf"),), "damaged"),
        (SUMMARY + 16, "d", (float("nan"),), "damaged"),
        (SUMMARY + 16, "d", (0.0,), "no segment of Chebyshev type 2"),
        (SUMMARY + 24, "d", (-1e10,), "claims"),
        (SUMMARY + 24 + 16 + 4, "i", (17,), "no segment of Chebyshev type 2 in the ICRF"),
        (SUMMARY + 24 + 16 + 12, "i", (-4,), "lies outside the file"),
        (LAST_BYTE - 8, "d", (5.5,), "directory"),
        (LAST_BYTE - 16, "d", (33.0,), "directory"),
        (LAST_BYTE - 24, "d", (345600.0,), "claims|record whose epoch"),
        (FIRST_BYTE + 32 * 8 * 50, "d", (0.0,), "record whose epoch"),
        (FIRST_BYTE + 32 * 8 * 50 + 80, "d", (float("nan"),), "not a number"),
    ],
)
def test_damage_to_a_file_of_ones_own(tmp_path, offset, layout, values, message):
    with pytest.raises(KernelError, match=message) as caught:
        open_pck(written(tmp_path, patched(offset, layout, *values)))
    assert "own.bpc" in str(caught.value)


def test_missing_body_names_file_span_and_what_there_is():
    kernel = open_spk("DE421")
    with pytest.raises(KernelError, match=r"de421_1969_2050\.bsp \(spanning.*4.*0"):
        kernel.segments_of(4, 0)[-1]
    held = {(segment.target, segment.center) for segment in kernel.segments}
    assert (301, 3) in held
    assert (4, 0) not in held


def test_a_sound_kernel_of_the_length_of_one_that_ships_is_read(tmp_path):
    swapped = tmp_path / "big_endian.bpc"
    swapped.write_bytes(with_other_byte_order(PCK_BYTES))
    ours, theirs = open_pck(swapped), open_pck("DE421")
    assert ours.file.sha256 != theirs.file.sha256
    assert np.array_equal(ours.segments[0].coefficients, theirs.segments[0].coefficients)
    relabelled = tmp_path / "relabelled.bsp"
    relabelled.write_bytes(SPK_PATH.read_bytes().replace(b"DE-0421LE-0421", b"DE-0430LE-0430"))
    assert open_spk(relabelled).segments[0].name == "DE-0430LE-0430"


@pytest.mark.parametrize("free", [None, 10**6])
def test_a_circular_list_of_segments_ends(tmp_path, free):
    """Also in a file that is shorter than its header says."""
    data = patched(SUMMARY, "d", SUMMARY / 1024 + 1)
    if free is not None:
        struct.pack_into("<i", data, 84, free)
        data = data[:4096]
    with pytest.raises(KernelError, match="runs in a circle" if free is None else "is cut short"):
        open_pck(written(tmp_path, data))
