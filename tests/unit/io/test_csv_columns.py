"""Cells in bulk: to the letter what Python writes one by one."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from radioloc.errors import InputError
from radioloc.io.csv_columns import (
    digits,
    fixed_cells,
    lines_of,
    text_cells,
    two_digits,
    unpadded_digits,
)

FLOATS = st.lists(
    st.one_of(
        st.floats(allow_nan=False, allow_infinity=False),
        st.floats(-1e9, 1e9),
        st.integers(-(2**40), 2**40).map(lambda k: k * 2.0**-9),  # exactly half way between two texts
        st.integers(-(10**9), 10**9).map(lambda k: k * 0.5e-7),
    ),
    min_size=1,
    max_size=20,
)


@given(FLOATS, st.integers(1, 8))
def test_fixed_decimals(values, decimals):
    found = fixed_cells(np.array(values), decimals).tolist()
    # Zero bytes within a cell are taken out with those behind it.
    assert [cell.replace(b"\0", b"").decode() for cell in found] == [
        f"{value:.{decimals}f}" for value in values
    ]


def characters(packed):
    return [row.tobytes().replace(b"\0", b"").decode() for row in packed]


def test_digits():
    numbers = np.array([0, 7, 99, 100, 9999, 10000, 50000000, 90071992, 123456789012])
    for count in range(12, 17):
        assert characters(digits(numbers, count)) == [f"{number:0{count}d}" for number in numbers]
    for groups in (3, 4):
        assert characters(unpadded_digits(numbers, groups)) == [str(number) for number in numbers]
    for count in range(1, 9):
        few = numbers[numbers < 10**count]
        assert characters(digits(few, count)) == [f"{number:0{count}d}" for number in few]
        assert characters(unpadded_digits(few, -(-count // 4))) == [str(number) for number in few]
    assert characters(two_digits(np.arange(100))) == [f"{number:02d}" for number in range(100)]


def test_lines_of_texts_of_any_script():
    names = np.array(["a", "Łódź", "", "±", "APOLLO>x>APOLLO"] * 14000)
    numbers = np.arange(len(names), dtype=float)
    columns = [lambda rows: text_cells(names[rows]), lambda rows: fixed_cells(numbers[rows], 1)]
    written = b"".join(lines_of(columns, len(names))).decode()
    assert written == "".join(
        f"{name},{number!r}\n" for name, number in zip(names, numbers.tolist(), strict=True)
    )
    with pytest.raises(InputError, match="is not text"):
        text_cells(["\ud800"])
