"""Types of measurement and their validation."""

import pytest

from radioloc.errors import InputError
from radioloc.measurements import Geometry, MeasurementType


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"geometry": Geometry.COMBINED}, "if and only if"),
        ({"name": "half range"}, "'half range'"),
        ({"tags": ("receive", "noon")}, "transmit, receive, bounce"),
    ],
)
def test_inconsistent_types(changes, words):
    arguments = {"name": "half_range", "description": "a value", "geometry": Geometry.ROUND_TRIP}
    with pytest.raises(InputError, match=words):
        MeasurementType(**(arguments | changes))
