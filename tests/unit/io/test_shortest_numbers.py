"""Numbers in as few digits as give back the same float: to the letter what Python writes one by one."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from radioloc.io.shortest_numbers import _decimal, shortest_cells

FLOATS = st.lists(
    st.one_of(
        st.floats(),
        st.floats(-1e9, 1e9),
        st.integers(-(2**60), 2**60).map(lambda k: k * 2.0**-40),
        st.tuples(st.integers(1, 10**16), st.integers(0, 20)).map(lambda n: float(f"{n[0]}e-{n[1]}")),
    ),
    max_size=20,
)


def written(values):
    # Zero bytes within a cell are taken out with those behind it.
    return [cell.replace(b"\0", b"").decode() for cell in shortest_cells(np.array(values)).tolist()]


def one_by_one(values):
    return ["" if value != value else repr(float(value)) for value in values]


@given(FLOATS)
def test_any_number(values):
    values = [*values, 0.0, -0.0]
    assert written(values) == one_by_one(values)


@pytest.mark.parametrize("decimals", [None, 0, 3, 7])
def test_many_numbers_of_all_sizes(decimals):
    rng = np.random.default_rng(2)
    values = rng.normal(0.0, 1.0, 30_000) * 10.0 ** rng.integers(-6, 17, 30_000)
    if decimals is not None:
        values = values.round(decimals)
    assert written(values) == one_by_one(values)


def test_around_powers_of_ten_and_two():
    powers = np.array([*(10.0**k for k in range(-5, 17)), *(2.0**k for k in range(-20, 54))])
    values = np.concatenate([np.nextafter(powers, side) for side in (-np.inf, np.inf)] + [powers, -powers])
    assert written(values) == one_by_one(values)


def test_hardly_any_number_is_left_to_python():
    rng = np.random.default_rng(3)
    _, _, doubtful = _decimal(rng.uniform(1e5, 1e9, 100_000))
    assert doubtful.mean() < 1e-3


def test_nothing():
    assert written([]) == []
    assert written([np.nan, np.inf, 1.0]) == ["", "inf", "1.0"]
