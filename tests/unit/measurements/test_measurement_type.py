"""Types of measurement and their validation."""

import pytest

from radioloc.errors import InputError
from radioloc.measurements import Geometry, Link, MeasurementType, Part


def parts(link):
    return (Part(0.5, "range", link),)


def test_form_of_the_path_follows_from_the_geometry():
    for geometry in set(Geometry) - {Geometry.COMBINED}:
        plain = MeasurementType("plain", "a value", geometry)
        assert plain.form == geometry.value
        assert plain.on_baseline == (geometry is Geometry.BASELINE)
        assert (plain.integrated, plain.positive) == (False, False)
    combined = MeasurementType("half", "a value", Geometry.COMBINED, form="target>receiver", parts=parts)
    assert combined.form == "target>receiver"
    assert combined.parts(Link.from_path("x>KASHI"))[0].weight == 0.5


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"geometry": Geometry.COMBINED}, "if and only if"),
        ({"parts": parts}, "if and only if"),
        ({"name": "half range"}, "'half range'"),
        ({"tags": ()}, "transmit, receive, bounce"),
        ({"tags": ("receive", "noon")}, "transmit, receive, bounce"),
        ({"geometry": Geometry.COMBINED, "parts": parts}, "a form of the path"),
    ],
)
def test_inconsistent_types(changes, words):
    arguments = {"name": "half_range", "description": "a value", "geometry": Geometry.ROUND_TRIP}
    with pytest.raises(InputError, match=words):
        MeasurementType(**(arguments | changes))
