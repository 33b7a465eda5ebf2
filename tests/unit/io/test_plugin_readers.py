"""What other packages add by entry points: taken if it is what it should be, else left out with a warning."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

import radioloc
from radioloc.errors import FileFormatError, PluginWarning
from radioloc.io import detect
from radioloc.io.detect import READERS, Reader
from radioloc.plugins import with_plugins

EXAMPLE = Path(__file__).parents[3] / "examples" / "apollo15" / "apollo15_apollo_2006-2007.csv"


@dataclass
class Point:
    name: str
    entry: Any
    value: str = "package:thing"

    def load(self):
        if isinstance(self.entry, Exception):
            raise self.entry
        return self.entry


def test_a_file_format_of_another_package(tmp_path, monkeypatch):
    made = radioloc.read_observations(EXAMPLE).select([0, 1])
    reader = Reader("rngbin", "RNGB", lambda head: head.startswith(b"RNGB\0"), lambda paths, settings: made)
    monkeypatch.setattr("radioloc.plugins.entry_points", lambda group: [Point("a", reader)])
    monkeypatch.setattr(detect, "READERS", with_plugins("radioloc.readers", Reader, READERS.values()))
    file = tmp_path / "a.bin"
    file.write_bytes(b"RNGB\0\1\2")
    assert radioloc.read_observations(file) is made
    file.write_text("hello")
    with pytest.raises(FileFormatError, match=r"none of the known formats: .*rngbin \(RNGB\)"):
        radioloc.read_observations(file)


@pytest.mark.parametrize(
    ("entry", "words"),
    [
        (ImportError("no such module"), r"cannot be loaded \(no such module\)"),
        ("text", "is a str, not a Reader"),
        (next(iter(READERS.values())), "which is taken"),
    ],
)
def test_what_cannot_be_used_is_left_out_with_a_warning(entry, words, monkeypatch):
    monkeypatch.setattr("radioloc.plugins.entry_points", lambda group: [Point("a", entry)])
    with pytest.warns(PluginWarning, match=words):
        assert with_plugins("radioloc.readers", Reader, READERS.values()) == READERS
