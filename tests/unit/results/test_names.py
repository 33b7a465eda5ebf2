"""Names of parameters and error sources in words."""

import pytest

from radioloc.results.names import parameter_name


@pytest.mark.parametrize(
    ("identifier", "name"),
    [
        ("clock.KASHI 2", "clock of KASHI, pass 2"),
        ("moon_position.along", "along-track position of the Moon"),
        ("moon_position_variation.2.radial", "radial variation of the Moon's position, session 2"),
        ("position.height_m", "position height"),
        ("transponder_delay", "transponder delay"),
    ],
)
def test_parameters_have_names_in_words(identifier, name):
    assert parameter_name(identifier) == name
