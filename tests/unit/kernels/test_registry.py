import dataclasses
import hashlib
import importlib.util

import pytest
from paths import ROOT

import radioloc.kernels.files as registry
from radioloc.errors import KernelError
from radioloc.kernels import find_kernel, registered
from radioloc.kernels.files import sha256_of

PROJECT = ROOT


def test_files_that_ship_are_what_the_registry_says():
    assert {entry.kind for entry in registered()} == {"SPK", "PCK"}
    for entry in registered():
        data = find_kernel(entry.name).read_bytes()
        assert hashlib.sha256(data).hexdigest() == entry.sha256
        assert len(data) == entry.size_bytes


def test_find_by_ephemeris_file_name_and_path(tmp_path):
    spk = find_kernel("DE421", "SPK")
    assert spk.name == "de421_1969_2050.bsp"
    assert find_kernel("de421", "PCK").name == "moon_pa_de421_1969_2050.bpc"
    assert find_kernel(spk.name) == spk
    copy = tmp_path / "own.bsp"
    copy.write_bytes(b"")
    assert find_kernel(str(copy)) == copy


def test_ambiguous_and_unknown_names_say_what_there_is():
    with pytest.raises(KernelError, match=r"more than one kernel.*de421_1969_2050\.bsp"):
        find_kernel("DE421")
    with pytest.raises(KernelError, match=r"'DE430'.*kernel.*moon_pa_de421_1969_2050"):
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


def test_script_refuses_a_source_that_is_too_short():
    script = _script()
    first = script.EXCERPTS[0]
    longer = dataclasses.replace(first, span=dataclasses.replace(first.span, end_s=1.7e9))
    with pytest.raises(SystemExit, match="does not cover"):
        script.make_excerpt(longer, find_kernel("DE421", "SPK").read_bytes())
