"""The a-priori errors of DE421 are what DE440 says of it: differences of the two files over the years.

DE421 was fitted to laser ranges until 2007, DE440 to thirteen years more with a better model of the Moon. What they
disagree by is mostly the error of the older one.
"""

import numpy as np
import pytest
from arc_cases import observed_at

from radioloc.lunar import rot_icrf_to_pa, rot_pa_to_me
from radioloc.measurements import PhysicalModel
from radioloc.parameters import PARAMETERS
from radioloc.time import Epochs

RADIUS_M = 1737400.0
# A sigma for all years and all phases of the month is right to this factor.
FACTOR = 1.6


@pytest.fixture(scope="module")
def models():
    return [PhysicalModel.build(ephemeris=name, libration=name) for name in ("DE421", "DE440")]


def spread(models, first_year, last_year):
    """DE440 less DE421: radial, along and normal, m; rotation of the mean-Earth axes, rad; each of shape (n, 3)."""
    days = np.linspace(first_year - 2000.0, last_year - 2000.0, 3000) * 365.25
    tdb = Epochs.from_jd(np.full(len(days), 2451545.0), days, "TDB")
    places_m = [model.ephemeris.geocentric("moon", tdb) for model in models]
    position_m, velocity_m_s = places_m[0]
    radial = position_m / np.linalg.norm(position_m, axis=-1)[:, None]
    normal = np.cross(position_m, velocity_m_s)
    normal /= np.linalg.norm(normal, axis=-1)[:, None]
    axes = np.stack([radial, np.cross(normal, radial), normal], axis=1)
    offset_m = np.einsum("nij,nj->ni", axes, places_m[1][0] - position_m)
    to_me = [
        rot_pa_to_me(model.ephemeris.constants) @ rot_icrf_to_pa(model.libration.angles(tdb)[0])
        for model in models
    ]
    turned = np.einsum("nij,nkj->nik", to_me[1], to_me[0])
    rotation_rad = 0.5 * np.stack(
        [turned[:, j, i] - turned[:, i, j] for i, j in ((1, 2), (2, 0), (0, 1))], axis=-1
    )
    return offset_m, rotation_rad


class _Rows:
    """Model and epochs for which a-priori sigmas are computed."""

    def __init__(self, model, year):
        epoch = Epochs.from_jd(2451545.0, np.array([(year - 2000.0) * 365.25]), "UTC")
        self.model = model
        self.observations = observed_at(epoch, "APOLLO>x>APOLLO", tag="transmit", value_m=7e8)


def apriori(kind, model, year):
    return np.array(PARAMETERS[kind].considered(_Rows(model, year), {"": 0})[""])


def test_axes_and_distance_by_two_ephemerides(models):
    """Documented differences: principal axes, mean-Earth axes, and the distance by the masses."""
    offset_m, me_rad = spread(models, 1990.1, 2049.9)
    me_m = RADIUS_M * np.linalg.norm(me_rad, axis=-1)
    assert (me_m.min(), me_m.max()) == pytest.approx((0.065, 0.533), abs=0.01)
    constants = [model.ephemeris.constants for model in models]
    between = rot_pa_to_me(constants[1]).T @ rot_pa_to_me(constants[0])  # as the constant angles have it
    constant_rad = 0.5 * np.array([between[j, i] - between[i, j] for i, j in ((1, 2), (2, 0), (0, 1))])
    pa_m = RADIUS_M * np.linalg.norm(me_rad + constant_rad, axis=-1)
    assert (pa_m.min(), pa_m.mean(), pa_m.max()) == pytest.approx((1.28, 1.50, 1.78), abs=0.01)
    assert offset_m[:, 0].mean() == pytest.approx(-0.216, abs=0.003)
    gm = [values.gm_earth_m3_s2 + values.gm_moon_m3_s2 for values in constants]
    assert (gm[1] / gm[0] - 1.0) / 3.0 * 384.4e6 == pytest.approx(-0.217, abs=0.001)  # Kepler's third law


@pytest.mark.parametrize(
    "years", [(2002.0, 2006.0), (2006.2, 2007.6), (2016.0, 2019.0), (2022.0, 2026.0), (2035.0, 2040.0)]
)
def test_what_varies_of_the_orbit(models, years):
    offset_m, _ = spread(models, *years)
    found_m = offset_m.std(axis=0)[[0, 2]]  # along the orbit there is a trend besides
    sigma_m = apriori("moon_position_variation", models[0], years[1])[[0, 2]]
    assert (np.abs(np.log(found_m / sigma_m)) < np.log(FACTOR)).all(), (found_m, sigma_m)


def test_what_varies_of_the_librations(models):
    _, rotation_rad = spread(models, 2006.2, 2024.4)
    sigma_rad = apriori("libration_variation", models[0], 2024.4)
    assert rotation_rad.std(axis=0) == pytest.approx(sigma_rad, rel=0.1)


def test_constant_sigmas_are_those_of_yearly_means(models):
    """The constant part excludes what varies: an arc of a year has both."""
    means = [[part.mean(axis=0) for part in spread(models, year, year + 1.0)] for year in range(1992, 2010)]
    offset_m, rotation_rad = (np.sqrt(np.square(part).mean(axis=0)) for part in zip(*means, strict=True))
    assert offset_m == pytest.approx(apriori("moon_position", models[0], 2007.0), rel=FACTOR - 1.0)
    assert rotation_rad == pytest.approx(apriori("libration", models[0], 2007.0), rel=FACTOR - 1.0)


def test_both_parts_together_are_the_whole_difference(models):
    offset_m, rotation_rad = (
        np.sqrt(np.square(part).mean(axis=0)) for part in spread(models, 1992.0, 2008.0)
    )
    for kind, difference in (("moon_position", offset_m), ("libration", rotation_rad)):
        parts = [apriori(name, models[0], 2007.0) for name in (kind, f"{kind}_variation")]
        assert np.hypot(*parts) == pytest.approx(difference, rel=0.4), kind


def test_the_newer_one_counts_as_half_as_wrong(models):
    for kind, components in (("moon_position_variation", slice(2)), ("libration_variation", slice(3))):
        older, newer = (apriori(kind, model, 2020.0)[components] for model in models)
        assert newer == pytest.approx(0.5 * older)
