import numpy as np
import pytest
from mappings import height_correction, niell

from radioloc.media.mapping_functions import MappingFactors, day_of_year
from radioloc.time import epochs_from_strings

GOLDSTONE = {"latitude_rad": np.deg2rad(35.4), "height_m": 1000.0, "day_of_year": 276.0}


def test_one_at_the_zenith() -> None:
    factors = niell(np.pi / 2, **GOLDSTONE)
    for value in (factors.hydrostatic, factors.wet):
        assert value == pytest.approx(1.0, abs=1e-15)
    for rate in (factors.hydrostatic_rate_rad, factors.wet_rate_rad):
        assert abs(rate) < 1e-15


def test_below_that_of_a_flat_earth_and_above_the_wet_below_hydrostatic() -> None:
    elevation = np.deg2rad([5.0, 10.0, 20.0, 45.0])
    factors = niell(elevation, **GOLDSTONE)
    # The water lies lower, where the Earth curves less.
    assert (factors.hydrostatic < factors.wet).all()
    assert (factors.wet < 1.0 / np.sin(elevation)).all()
    assert (np.diff(factors.hydrostatic) < 0.0).all()


@pytest.mark.parametrize("elevation_deg", [3.001, 6.0, 10.0, 20.0, 45.0, 85.0])
def test_rates_are_the_derivatives(elevation_deg: float) -> None:
    elevation, step = np.deg2rad(elevation_deg), 1e-6
    here = niell(elevation, **GOLDSTONE)
    there, back = niell(elevation + step, **GOLDSTONE), niell(elevation - step, **GOLDSTONE)
    for name in ("hydrostatic", "wet"):
        difference = (getattr(there, name) - getattr(back, name)) / (2.0 * step)
        # Rounding of a number near 15 over 2e-6, and at 3 degrees the third derivative of 1e6 times 1e-12 / 6.
        np.testing.assert_allclose(getattr(here, f"{name}_rate_rad"), difference, rtol=1e-9, atol=5e-9)


def test_south_has_the_seasons_half_a_year_later() -> None:
    elevation = np.deg2rad(10.0)
    north = niell(elevation, np.deg2rad(40.0), 0.0, 28.0)
    south = niell(elevation, np.deg2rad(-40.0), 0.0, 28.0 + 365.25 / 2.0)
    assert north.hydrostatic == pytest.approx(south.hydrostatic, abs=1e-14)
    same_day = niell(elevation, np.deg2rad(-40.0), 0.0, 28.0)
    assert north.hydrostatic - same_day.hydrostatic > 1e-3
    assert north.wet == same_day.wet


def test_constant_beyond_the_table() -> None:
    elevation, day = np.deg2rad(10.0), 100.0
    tropics = niell(elevation, np.deg2rad([0.0, 10.0, 15.0]), 0.0, day)
    poles = niell(elevation, np.deg2rad([75.0, 82.0, 90.0]), 0.0, day)
    assert np.ptp(tropics.hydrostatic) == np.ptp(poles.hydrostatic) == 0.0
    # There is no season at 15 degrees and below.
    assert tropics.hydrostatic[0] == niell(elevation, 0.0, 0.0, 200.0).hydrostatic


def test_height_correction() -> None:
    correction, _ = height_correction(np.deg2rad([20.0, 90.0]), 1000.0)
    # Leading term of its expansion for high elevations.
    assert correction[0] == pytest.approx(
        2.53e-5 / np.tan(np.deg2rad(20.0)) ** 2 / np.sin(np.deg2rad(20.0)), rel=0.06
    )
    assert correction[1] == pytest.approx(0.0, abs=1e-15)
    np.testing.assert_allclose(height_correction(0.3, 2000.0), 2.0 * np.array(height_correction(0.3, 1000.0)))


def test_broadcasts() -> None:
    factors = niell(np.deg2rad([[10.0], [30.0]]), np.deg2rad([10.0, 40.0, -60.0]), 500.0, 12.0)
    assert isinstance(factors, MappingFactors)
    assert factors.hydrostatic.shape == factors.wet.shape == factors.wet_rate_rad.shape == (2, 3)
    one = niell(np.deg2rad(30.0), np.deg2rad(-60.0), 500.0, 12.0)
    assert one.hydrostatic.shape == ()
    assert factors.hydrostatic[1, 2] == one.hydrostatic


def test_day_of_year() -> None:
    epochs = epochs_from_strings(
        ["2021-01-01T00:00:00", "2020-03-01T12:00:00", "2020-12-31T18:00:00", "2021-12-31"], "TT"
    )
    np.testing.assert_array_equal(day_of_year(epochs), [1.0, 61.5, 366.75, 365.0])
