"""Exchange with Orekit where its package is not installed."""

import sys

import pytest

from radioloc.errors import InputError
from radioloc.io import from_orekit


def test_a_missing_package_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "orekit_jpype", None)
    with pytest.raises(InputError, match="bench"):
        from_orekit([])
