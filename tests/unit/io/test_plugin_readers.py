"""A file format that another package adds by an entry point."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

import radioloc
from radioloc.errors import FileFormatError
from radioloc.io import formats
from radioloc.io.formats import READERS, Reader
from radioloc.plugins import registry

EXAMPLE = Path(__file__).parents[3] / "examples" / "apollo15" / "apollo15_apollo_2006-2007.csv"


@dataclass
class Point:
    name: str
    entry: Any

    def load(self):
        return self.entry


def test_a_file_format_of_another_package(tmp_path, monkeypatch):
    made = radioloc.read_observations(EXAMPLE).select([0, 1])
    own = list(READERS.values())
    reader = Reader("rngbin", "RNGB", lambda head: head.startswith(b"RNGB\0"), lambda paths, settings: made)
    monkeypatch.setattr("radioloc.plugins.entry_points", lambda group: [Point("a", reader)])
    monkeypatch.setattr(formats, "READERS", registry("radioloc.readers", Reader, own))
    file = tmp_path / "a.bin"
    file.write_bytes(b"RNGB\0\1\2")
    assert radioloc.read_observations(file) is made
    file.write_text("hello")
    with pytest.raises(FileFormatError, match=r"none of the known formats: .*rngbin \(RNGB\)"):
        radioloc.read_observations(file)
