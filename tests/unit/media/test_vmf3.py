from importlib.resources import files

import numpy as np
import pytest
from mappings import continued_fraction, height_correction, vmf3

from radioloc.media.mapping_functions import vmf3_bc

GOLDSTONE = {
    "hydrostatic_a": 1.22e-3,
    "wet_a": 5.5e-4,
    "latitude_rad": np.deg2rad(35.4),
    "longitude_rad": np.deg2rad(-116.9),
    "day_of_year": 276.0,
    "height_above_a_m": 1000.0,
}


def test_made_of_the_continued_fraction_and_the_height_correction() -> None:
    elevation = np.deg2rad([5.0, 20.0, 90.0])
    factors = vmf3(elevation, **GOLDSTONE)
    b_h, b_w, c_h, c_w = vmf3_bc(
        *(GOLDSTONE[key] for key in ("latitude_rad", "longitude_rad", "day_of_year"))
    )
    plain, _ = continued_fraction(elevation, 1.22e-3, b_h, c_h)
    above, _ = height_correction(elevation, 1000.0)
    np.testing.assert_array_equal(factors.hydrostatic, plain + above)
    np.testing.assert_array_equal(factors.wet, continued_fraction(elevation, 5.5e-4, b_w, c_w)[0])
    assert factors.hydrostatic[-1] == pytest.approx(1.0, abs=1e-15)


@pytest.mark.parametrize("elevation_deg", [3.001, 10.0, 20.0, 85.0])
def test_rates_are_the_derivatives(elevation_deg: float) -> None:
    elevation, step = np.deg2rad(elevation_deg), 1e-6
    here = vmf3(elevation, **GOLDSTONE)
    there, back = vmf3(elevation + step, **GOLDSTONE), vmf3(elevation - step, **GOLDSTONE)
    for name in ("hydrostatic", "wet"):
        difference = (getattr(there, name) - getattr(back, name)) / (2.0 * step)
        np.testing.assert_allclose(getattr(here, f"{name}_rate_rad"), difference, rtol=1e-9, atol=5e-9)


def test_coefficients_are_those_of_their_kind() -> None:
    """Each near the constants of VMF1, 0.0029, 0.00146, 0.062 to 0.072, 0.044, anywhere on Earth and at any time."""
    latitude, longitude, day = np.meshgrid(
        np.deg2rad([-90.0, -45.0, 0.0, 30.0, 90.0]),
        np.deg2rad([0.0, 90.0, 200.0, 340.0]),
        [1.0, 100.0, 250.0],
    )
    ranges = [(0.0023, 0.0032), (0.0005, 0.003), (0.05, 0.08), (0.01, 0.09)]
    for values, (least, most) in zip(vmf3_bc(latitude, longitude, day), ranges, strict=True):
        assert values.shape == latitude.shape
        assert (values > least).all()
        assert (values < most).all()


def test_longitude_counts_either_way_and_not_at_the_poles() -> None:
    east, west = (vmf3_bc(0.6, np.deg2rad(longitude), 12.0) for longitude in (243.1, -116.9))
    # Rounding of 12 times a longitude of 4 rad.
    np.testing.assert_allclose(east, west, rtol=1e-13)
    pole = np.array(vmf3_bc(np.pi / 2, np.array([0.0, 1.0, 2.0]), 12.0))
    np.testing.assert_allclose(pole, pole[:, :1] * np.ones(3), rtol=1e-13)


def test_harmonics_by_their_definition() -> None:
    """The packaged table summed with P_nm(x) = (1 - x^2)^(m/2) d^m P_n / dx^m of numpy's Legendre series."""
    latitude, longitude, day = -0.5, 2.0, 77.0
    x, year = np.sin(latitude), 2.0 * np.pi * day / 365.25
    seasons = [1.0, np.cos(year), np.sin(year), np.cos(2.0 * year), np.sin(2.0 * year)]
    sums = dict.fromkeys(("bh", "bw", "ch", "cw"), 0.0)
    table = (files("radioloc.media") / "data" / "vmf3_bc.csv").read_text().splitlines()
    rows = [line.split(",") for line in table if line[:2] in sums]
    assert len(rows) == 4 * 91
    for name, degree, order, *factors in rows:
        n, m = int(degree), int(order)
        polynomial = np.polynomial.Legendre.basis(n)
        associated = np.cos(latitude) ** m * (polynomial.deriv(m) if m else polynomial)(x)
        cosine, sine = np.dot(np.reshape(factors, (2, 5)).astype(float), seasons)
        sums[name] += associated * (cosine * np.cos(m * longitude) + sine * np.sin(m * longitude))
    np.testing.assert_allclose(vmf3_bc(latitude, longitude, day), list(sums.values()), rtol=1e-12)
