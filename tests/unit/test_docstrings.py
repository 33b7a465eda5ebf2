"""Examples in docstrings run and show what they say."""

from __future__ import annotations

import doctest
import importlib
import pkgutil

import pytest

import radioloc

NAMES = [m.name for m in pkgutil.walk_packages(radioloc.__path__, "radioloc.") if "__main__" not in m.name]


@pytest.mark.parametrize("package", ["time", "ephemeris", "earth", "lunar"])
def test_examples(package):
    results = [
        doctest.testmod(importlib.import_module(name))
        for name in NAMES
        if name.startswith(f"radioloc.{package}.")
    ]
    assert sum(result.attempted for result in results) > 0
    assert sum(result.failed for result in results) == 0
