"""Progress on a terminal: status line, bars, colour of the status, and silence elsewhere."""

import io
import sys
import time

import numba
import pytest

import radioloc.compiled  # noqa: F401  its listener
from radioloc import progress
from radioloc.cli.output import say
from radioloc.progress import SILENT, announce, progress_bar, status_line, step

REMOVED = "\r\x1b[2K"


def open_terminal(monkeypatch):
    """Replace standard error by a terminal, in the test itself, as pytest replaces it after fixtures."""
    stream = io.StringIO()
    stream.isatty = lambda: True
    monkeypatch.setattr(sys, "stderr", stream)
    monkeypatch.setattr(progress, "_MIN_SHOWN_S", 0.0)
    monkeypatch.setattr(progress, "_REFRESH_S", 0.001)
    return stream


def wait_for(stream, text):
    for _ in range(2000):
        if stream.getvalue().endswith(text):
            return
        time.sleep(0.001)
    pytest.fail(f"{text!r} is missing in {stream.getvalue()!r}")


def test_the_innermost_step_is_shown_and_removed(monkeypatch):
    terminal = open_terminal(monkeypatch)
    with status_line("locate"):
        with step("fitting"):
            wait_for(terminal, "fitting ... 0 s")
        wait_for(terminal, "locate ... 0 s")
    assert terminal.getvalue().endswith(REMOVED)
    with step("outside of a command"):
        assert terminal.getvalue().endswith(REMOVED)


def test_a_bar_replaces_the_status_line(monkeypatch):
    terminal = open_terminal(monkeypatch)
    with status_line("montecarlo"):
        wait_for(terminal, "montecarlo ... 0 s")
        with progress_bar(shown=True, total=3):
            time.sleep(0.02)
            assert "montecarlo" not in terminal.getvalue().rpartition(REMOVED)[2]
        wait_for(terminal, "montecarlo ... 0 s")


@pytest.mark.parametrize("silent", [True, False])
def test_with_quiet_or_in_a_pipe_nothing_is_shown(silent, monkeypatch):
    terminal = open_terminal(monkeypatch)
    if not silent:
        terminal.isatty = lambda: False
    token = SILENT.set(silent)
    with status_line("locate"), step("fitting"):
        time.sleep(0.01)
    announce("compiling")
    SILENT.reset(token)
    assert terminal.getvalue() == ""


def test_compilation_is_announced_once_or_is_a_step(monkeypatch):
    terminal = open_terminal(monkeypatch)
    monkeypatch.setattr(progress, "_announced", set())
    numba.njit(lambda x: 2 * x)(1.0)
    announce("compiling the inner loops (once) ...")
    [line] = terminal.getvalue().splitlines()
    assert "compiling" in line
    with status_line("locate"):
        numba.njit(lambda x: 3 * x)(1.0)
    assert "compiling the inner loops (once) ... 0 s" in terminal.getvalue()


@pytest.mark.parametrize(
    ("no_color", "name", "text"),
    [
        ("", "xterm", "status      \x1b[32mgood\x1b[0m\n"),
        ("1", "xterm", "status      good\n"),
        ("", "dumb", "status      good\n"),
    ],
)
def test_the_status_has_a_colour_where_the_terminal_has(no_color, name, text, monkeypatch):
    stream = io.StringIO()
    stream.isatty = lambda: True
    monkeypatch.setattr(sys, "stdout", stream)
    monkeypatch.setenv("NO_COLOR", no_color)
    monkeypatch.setenv("TERM", name)
    say("status      good", colour=32)
    assert stream.getvalue() == text
