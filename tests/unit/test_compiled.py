"""Compiled functions: their code is kept where that can be."""

import errno
import importlib.util

from numba.core import caching

SOURCE = "from radioloc.compiled import compiled\n\n\n@compiled()\ndef triple(x):\n    return 3 * x\n"


def hits(folder):
    """Number of code files that the function of a new process would find; it must do what it is for."""
    (folder / "toy.py").exists() or (folder / "toy.py").write_text(SOURCE)
    spec = importlib.util.spec_from_file_location("toy", folder / "toy.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    assert module.triple(14) == 42
    return sum(module.triple.stats.cache_hits.values())


def test_code_is_kept(tmp_path):
    assert [hits(tmp_path), hits(tmp_path)] == [0, 1]


def test_nowhere_to_keep_code(tmp_path, monkeypatch):
    def no_space(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(caching._CacheLocator, "ensure_cache_path", no_space)
    assert [hits(tmp_path), hits(tmp_path)] == [0, 0]
