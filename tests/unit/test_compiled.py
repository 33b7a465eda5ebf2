"""Compiled functions: their code is kept, and compiled again where what was kept is damaged or cannot be written."""

import errno
import importlib.util
import sys

import pytest
from numba.core import caching

SOURCE = "from radioloc.compiled import compiled\n\n\n@compiled()\ndef triple(x):\n    return 3 * x\n"


def hits(folder):
    """How many of its code files a new process's function would find; it must do what it is for."""
    (folder / "toy.py").exists() or (folder / "toy.py").write_text(SOURCE)
    spec = importlib.util.spec_from_file_location("toy", folder / "toy.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    assert module.triple(14) == 42
    return sum(module.triple.stats.cache_hits.values())


def kept(folder, ending):
    (file,) = (folder / "__pycache__").glob(f"*.{ending}")
    return file


def test_code_is_kept(tmp_path):
    assert [hits(tmp_path), hits(tmp_path)] == [0, 1]


def flipped(content):
    middle = len(content) // 2
    return content[:middle] + bytes([content[middle] ^ 1]) + content[middle + 1 :]


@pytest.mark.parametrize("ending", ["nbc", "nbi"])
@pytest.mark.parametrize(
    "damage", [flipped, lambda content: b"", lambda content: content[:-40], lambda content: b"\xff" * 500]
)
def test_damaged_code_is_compiled_again(ending, damage, tmp_path):
    hits(tmp_path)
    file = kept(tmp_path, ending)
    file.write_bytes(damage(file.read_bytes()))
    first, second = hits(tmp_path), hits(tmp_path)
    assert (first, second) == (0, 1) or (ending == "nbi" and damage is flipped and second == 1)


def no_space(*_):
    raise OSError(errno.ENOSPC, "No space left on device")


@pytest.mark.parametrize(
    "owner_and_name",
    [(caching._CacheLocator, "ensure_cache_path"), (caching.IndexDataCacheFile, "_open_for_write")],
)
def test_nowhere_to_keep_code(owner_and_name, tmp_path, monkeypatch):
    monkeypatch.setattr(*owner_and_name, no_space)
    assert [hits(tmp_path), hits(tmp_path)] == [0, 0]


def test_code_is_compiled_again_when_a_module_it_calls_changes(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    (tmp_path / "toy.py").write_text(
        "from inner_toy import double\n" + SOURCE.replace("3 * x", "double(x) + x")
    )
    for factor, expected in ((2, 42), (20, 294)):
        (tmp_path / "inner_toy.py").write_text(SOURCE.replace("triple", "double").replace("3", str(factor)))
        sys.modules.pop("inner_toy", None)
        spec = importlib.util.spec_from_file_location("toy", tmp_path / "toy.py")
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        assert module.triple(14) == expected
        assert not module.triple.stats.cache_hits
