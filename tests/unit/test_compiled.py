"""Compiled functions: their code is kept where that can be."""

import errno
import importlib.util
import io
import sys

import numba
from numba.core import caching

import radioloc.compiled  # noqa: F401  its listener
from radioloc.progress import SILENT, announce

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


def test_compilation_is_announced_once_on_a_terminal(monkeypatch):
    terminal = io.StringIO()
    terminal.isatty = lambda: True
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setattr("radioloc.progress._announced", set())
    for factor in (2, 3):
        numba.njit(lambda x, factor=factor: factor * x)(1.0)
    lines = terminal.getvalue().splitlines()
    assert len(lines) == 1
    assert "compiling" in lines[0]


def test_nothing_is_announced_with_quiet_or_in_a_pipe(monkeypatch, capsys):
    announce("a step")
    terminal = io.StringIO()
    terminal.isatty = lambda: True
    monkeypatch.setattr(sys, "stderr", terminal)
    token = SILENT.set(True)
    announce("a step")
    SILENT.reset(token)
    assert capsys.readouterr().err == terminal.getvalue() == ""
