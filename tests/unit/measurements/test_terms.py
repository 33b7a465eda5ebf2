"""Names of terms."""

import pytest

from radioloc.errors import InputError
from radioloc.measurements.terms import TERMS, active_terms


def test_all_are_active_unless_left_out():
    assert active_terms() == frozenset(TERMS)
    assert {"shapiro", "lunar_tide", "troposphere", "ionosphere", "antenna_axis_offset"} < active_terms()
    assert active_terms(["shapiro", "tdb_tt"]) == frozenset(TERMS) - {"shapiro", "tdb_tt"}
    assert active_terms(iter(TERMS)) == frozenset()


def test_unknown_name_gets_the_nearest():
    with pytest.raises(InputError, match=r"'shapero' is not a term .*did you mean 'shapiro'\?"):
        active_terms(["shapero"])
    with pytest.raises(InputError, match="the terms are shapiro, tdb_tt"):
        active_terms(["xyz"])
