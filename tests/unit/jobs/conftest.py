"""The published laser ranges of the examples, and what a study of them is made of."""

import pytest
from paths import EXAMPLES

import radioloc


@pytest.fixture(scope="session")
def apollo15():
    """153 light times of the Apache Point station, 2006 to 2007."""
    return radioloc.read_observations(EXAMPLES / "apollo15" / "apollo15_apollo_2006-2007.csv")


@pytest.fixture(scope="session")
def late15():
    """28 light times of three stations, May 2024."""
    return radioloc.read_observations(EXAMPLES / "reflectors/2024" / "apollo15_2024.csv")


@pytest.fixture(scope="session")
def near15():
    """A-priori position 5 km off."""
    return radioloc.LunarPosition.from_selenographic(3.5, 26.0, -1000.0, "ME_DE421")
