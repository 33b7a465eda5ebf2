"""A type of measurement says what it is, or why it cannot be one: plug-ins make their own."""

import pytest

from radioloc.errors import InputError
from radioloc.measurements import Geometry, Link, MeasurementType, Part


def parts(link):
    return (Part(0.5, "range", link),)


def test_the_form_of_the_path_follows_from_the_geometry():
    for geometry in set(Geometry) - {Geometry.COMBINED}:
        plain = MeasurementType("plain", "a value", geometry)
        assert plain.form == geometry.value
        assert plain.on_baseline == (geometry is Geometry.BASELINE)
        assert (plain.integrated, plain.positive) == (False, False)
    combined = MeasurementType("half", "a value", Geometry.COMBINED, form="target>receiver", parts=parts)
    assert combined.form == "target>receiver"
    assert combined.parts(Link.from_path("x>KASHI"))[0].weight == 0.5


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"geometry": Geometry.COMBINED}, "parts belong to Geometry.COMBINED, and only to it"),
        ({"parts": parts}, "parts belong to Geometry.COMBINED, and only to it"),
        ({"name": "half range"}, "'half range' needs a name of letters and underscores"),
        ({"tags": ()}, "time tags out of transmit, receive, bounce"),
        ({"tags": ("receive", "noon")}, "time tags out of transmit, receive, bounce"),
        ({"geometry": Geometry.COMBINED, "parts": parts}, "a form of path"),
    ],
)
def test_a_type_that_contradicts_itself_is_refused(changes, message):
    given = {"name": "half_range", "description": "a value", "geometry": Geometry.ROUND_TRIP}
    with pytest.raises(InputError, match=message):
        MeasurementType(**(given | changes))
