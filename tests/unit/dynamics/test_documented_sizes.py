"""Sizes of the accelerations are those that docs/dynamics.md has."""

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest

from radioloc.dynamics import Forces, GravityField, acceleration_sizes
from radioloc.errors import InputError
from radioloc.time import epochs_from_strings

PAGE = Path(__file__).parents[3] / "docs" / "dynamics.md"
ROW = re.compile(r"^\| (?:`(\w+)`)? ?\| (.*) \| ([\d.e-]*) \| ([\d.e-]*) ?\|$", re.MULTILINE)
ROWS = [match.groups() for match in ROW.finditer(PAGE.read_text())]
EPOCH = epochs_from_strings("2012-04-09", "TDB")
HEIGHTS_M = (50e3, 5000e3)
FIELD = GravityField.open("GRGM660PRIM")


def same(found, text):
    """Two digits; blanks are below 1e-15."""
    return f"{found:.1e}" == f"{float(text):.1e}" if text else found < 1e-15


@pytest.mark.study
def test_of_all_forces():
    forces = Forces(FIELD, radiation_m2_kg=0.02)
    table = {name: sizes for name, _, *sizes in ROWS if name}
    for column, height_m in enumerate(HEIGHTS_M):
        sizes = acceleration_sizes(EPOCH, height_m, forces)
        assert sizes.pop("given") == 0.0
        assert set(table) == set(sizes)
        for name, found in sizes.items():
            assert same(found, table[name][column]), (name, found)


BANDS = [(what, sizes) for name, what, *sizes in ROWS if not name]


@pytest.mark.study
@pytest.mark.parametrize(("what", "sizes"), BANDS, ids=[what for what, _ in BANDS])
def test_of_degrees(what, sizes):
    lowest, highest = [int(word) for word in re.findall(r"\d+", what) * 2][:2]
    field = FIELD.to_degree(highest)
    within = np.arange(highest + 1)[:, None] >= lowest
    band = dataclasses.replace(field, c=np.where(within, field.c, 0.0), s=np.where(within, field.s, 0.0))
    for height_m, text in zip(HEIGHTS_M, sizes, strict=True):
        found = acceleration_sizes(EPOCH, height_m, Forces(band))["harmonics"]
        assert same(found, text), found


def test_a_height_that_is_none():
    with pytest.raises(InputError, match="not above the sphere"):
        acceleration_sizes(EPOCH, -1.0, Forces(FIELD))
