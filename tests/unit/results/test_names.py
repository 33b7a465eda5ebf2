"""Names of parameters and error sources in words."""

import pytest

from radioloc.results.names import parameter_name, source_name


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


def test_sources_of_error_have_names_in_words():
    assert source_name("libration") == "libration of the Moon"
    assert source_name("station_position") == "station coordinates"
    assert source_name("measurement noise") == "measurement noise"
