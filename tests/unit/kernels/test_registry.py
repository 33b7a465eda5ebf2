from __future__ import annotations

import dataclasses
import hashlib
import importlib.util
import struct
from pathlib import Path

import numpy as np
import pytest

import radioloc.kernels.files as registry
from radioloc.errors import KernelError
from radioloc.kernels import find_kernel, registered, sha256_of

PROJECT = Path(__file__).parents[3]


def test_files_that_ship_are_what_the_registry_says():
    assert {entry.kind for entry in registered()} == {"SPK", "PCK"}
    for entry in registered():
        data = find_kernel(entry.name).read_bytes()
        assert hashlib.sha256(data).hexdigest() == entry.sha256
        assert len(data) == entry.size_bytes


def test_comment_area_names_the_source_and_its_checksum():
    for entry in registered():
        comments = find_kernel(entry.name).read_bytes()[1024:3072].replace(b"\0", b"\n").decode("latin-1")
        for fact in (
            entry.source_file,
            entry.source_sha256,
            entry.source_package,
            entry.start_tdb,
            entry.end_tdb,
        ):
            assert fact in comments


def test_find_by_ephemeris_file_name_and_path(tmp_path):
    spk = find_kernel("DE421", "SPK")
    assert spk.name == "de421_1969_2050.bsp"
    assert find_kernel("de421", "PCK").name == "moon_pa_de421_1969_2050.bpc"
    assert find_kernel(spk.name) == spk
    own = tmp_path / "own.bsp"
    own.write_bytes(b"")
    assert find_kernel(str(own)) == own


def test_ambiguous_and_unknown_names_say_what_there_is():
    with pytest.raises(KernelError, match=r"more than one kernel.*de421_1969_2050\.bsp"):
        find_kernel("DE421")
    with pytest.raises(KernelError, match=r"'DE430' is neither a file nor a kernel.*moon_pa_de421_1969_2050"):
        find_kernel("DE430", "SPK")


def test_unreadable_file(tmp_path):
    with pytest.raises(KernelError, match="cannot be read"):
        sha256_of(tmp_path / "absent.bsp")


def test_missing_installation_is_reported(monkeypatch):
    monkeypatch.setattr(registry, "REGISTRY_NAME", "no_such_registry.toml")
    registry.kernel_directory.cache_clear()
    try:
        with pytest.raises(KernelError, match="install the package again"):
            registry.kernel_directory()
    finally:
        registry.kernel_directory.cache_clear()


def _script():
    path = PROJECT / "kernels" / "make_excerpts.py"
    if not path.is_file():
        pytest.skip("kernels/make_excerpts.py is only in a source checkout")
    import sys

    spec = importlib.util.spec_from_file_location("make_excerpts", path)
    module = importlib.util.module_from_spec(spec)
    # Dataclasses look their module up while it is being executed.
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("entry", registered(), ids=lambda entry: entry.name)
def test_excerpt_of_the_excerpt_has_the_same_records(entry):
    # Cutting what is already cut must keep every record, byte for byte; only the comment area differs.
    script = _script()
    (excerpt,) = (e for e in script.EXCERPTS if e.name == entry.name)
    source = find_kernel(entry.name).read_bytes()
    data, text = script.make_excerpt(excerpt, source)
    assert script.read_segments(data, entry.kind) == script.read_segments(source, entry.kind)
    assert data == script.make_excerpt(excerpt, source)[0]
    assert hashlib.sha256(source).hexdigest() in text


def test_libration_of_the_binary_form_becomes_a_segment():
    """Three 32-day records in JPL's layout, coefficients made up: each part of a record is one record of a PCK."""
    script = _script()
    coefficients, parts, record_days, first_jd, records = 3, 4, 32.0, 2447888.5, 3
    triples = [(3, 4, 1)] + [(15, 0, 0)] * 11 + [(15, coefficients, parts)]
    words = 2 + 12 + 3 * coefficients * parts
    # The header is one record as long as the others, and here longer than the real one's needs.
    words = max(words, 500)
    triples[1] = (15, (words - 14 - 3 * coefficients * parts) // 3, 1)
    words = 14 + 3 * triples[1][1] + 3 * coefficients * parts
    triples[-1] = (15 + 3 * triples[1][1], coefficients, parts)
    header = bytearray(words * 8)
    last_jd = first_jd + records * record_days
    struct.pack_into("<3di2d", header, 2652, first_jd, last_jd, record_days, 2, 149597870.7, 81.3)
    struct.pack_into("<36i", header, 2652 + 44, *(n for triple in triples[:12] for n in triple))
    struct.pack_into("<i3i", header, 2652 + 188, 440, *triples[-1])
    values = np.random.default_rng(440).normal(size=(records, words))
    values[:, 0] = first_jd + record_days * np.arange(records)
    values[:, 1] = values[:, 0] + record_days
    segment = script.read_libration(bytes(header) + bytes(words * 8) + values.astype("<f8").tobytes(), 31008)
    *array, init_s, length_s, size, count = np.frombuffer(segment.array, "<f8")
    assert (init_s, length_s, size, count) == ((first_jd - 2451545.0) * 86400.0, 8 * 86400.0, 11, 12)
    table = np.reshape(array, (12, 11))
    assert np.array_equal(table[:, 0], init_s + length_s * (np.arange(12) + 0.5))
    assert (table[:, 1] == length_s / 2.0).all()
    assert np.array_equal(table[:, 2:].ravel(), values[:, triples[-1][0] - 1 :].ravel())
    assert segment.codes == (31008, 1, 2)
    with pytest.raises(SystemExit, match="binary form"):
        script.read_libration(bytes(header) + bytes(words * 16 + 8), 31008)


def test_script_refuses_a_source_that_is_too_short():
    script = _script()
    first = script.EXCERPTS[0]
    longer = dataclasses.replace(first, span=dataclasses.replace(first.span, end_s=1.7e9))
    with pytest.raises(SystemExit, match="does not cover"):
        script.make_excerpt(longer, find_kernel("DE421", "SPK").read_bytes())
