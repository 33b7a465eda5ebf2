"""Tides of the oceans; reference/test_iers_displacements.py has the values of HARDISP."""

import numpy as np
import pytest

from radioloc.earth.geodesy import itrf_from_geodetic, rot_itrf_to_enu
from radioloc.earth.ocean_loading import (
    GIVEN_TIDES,
    TIDAL_GEOCENTRE_M,
    amplitudes_by_given,
    loading_enu_m,
    loading_itrf_m,
    sum_of_tides,
    tidal_potential,
)
from radioloc.earth.stations import StationCatalogue
from radioloc.time import Epochs

ROUNDING_M = 1e-15
SHANGHAI = StationCatalogue.default()["SESHAN25"].ocean_loading


def given_columns():
    multipliers, equilibrium_m = tidal_potential()
    columns = [int(np.flatnonzero((multipliers == tide).all(axis=1))[0]) for tide in GIVEN_TIDES]
    return multipliers, equilibrium_m, columns


def test_table_of_the_tidal_potential() -> None:
    """Cartwright and Edden (1973): M2, S2, N2, K2, K1, O1, P1, Q1, Mf, Mm, Ssa."""
    multipliers, equilibrium_m, columns = given_columns()
    assert len({tuple(row) for row in multipliers}) == len(multipliers) == 342
    expected = (0.632208, 0.294107, 0.121046, 0.079915, 0.368645, -0.262232, -0.121995, -0.050208)
    assert equilibrium_m[columns].tolist() == [*expected, -0.066607, -0.035184, -0.030988]


def test_equal_admittance_gives_the_equilibrium_tide() -> None:
    """A response equal at all frequencies preserves the ratios of the potential."""
    _, equilibrium_m, columns = given_columns()
    found_m = np.abs(0.01 * np.abs(equilibrium_m[columns]) @ amplitudes_by_given())
    np.testing.assert_allclose(found_m, 0.01 * np.abs(equilibrium_m), rtol=0.0, atol=ROUNDING_M)


def test_sum_repeats_with_the_nodal_modulation() -> None:
    """M2 alone is modulated by 3.7 % with the node's 18.6 years (Doodson and Warburg 1941)."""
    multipliers, equilibrium_m, columns = given_columns()
    semidiurnal = np.where(GIVEN_TIDES[:, 0] == 2, equilibrium_m[columns], 0.0)
    side = (multipliers == (2, 0, 0, 0, -1, 0)).all(axis=1)
    assert abs(np.abs(semidiurnal @ amplitudes_by_given())[side][0] / 0.632208 - 0.0373) < 5e-4


@pytest.mark.parametrize(
    ("argument_turns", "in_phase_m", "cross_phase_m"),
    [
        # M2, K1 and O1 of FES2004 (Onsala): x, y, z.
        (
            lambda ut1, s, h: 2 * (ut1 + h - s),
            (-1.3724e-3, 1.1479e-3, -1.2661e-3),
            (8.2077e-4, 2.3005e-4, -1.4298e-3),
        ),
        (
            lambda ut1, s, h: ut1 + h + 0.25,
            (-1.8539e-3, -9.1022e-4, -1.1370e-3),
            (-8.6426e-4, -1.7823e-3, 4.4839e-3),
        ),
        (
            lambda ut1, s, h: ut1 + h - 2 * s - 0.25,
            (-1.3985e-3, -8.8858e-4, -1.6802e-4),
            (-2.2975e-4, -6.4989e-4, 2.9702e-3),
        ),
    ],
)
def test_geocentre_has_the_published_tides(argument_turns, in_phase_m: tuple, cross_phase_m: tuple) -> None:
    """Cosine and sine parts at the astronomical arguments of tide tables, with hours from midnight (Schwiderski 1983).

    Epochs at random over a turn of the node leave 2 % of one tide in the estimate of another.
    """
    ut1 = Epochs.from_jd(2456000.5, np.random.default_rng(3).uniform(0.0, 6798.4, 8000), "UT1")
    tt = Epochs.from_jd(ut1.jd, ut1.fraction + 69.0 / 86400.0, "TT")
    centuries = tt.centuries_since_j2000()
    s = (218.3166 + 481267.8813 * centuries) / 360.0
    h = (280.4665 + 36000.7698 * centuries) / 360.0
    argument = 2.0 * np.pi * argument_turns(ut1.fraction, s, h)
    series_m = sum_of_tides(TIDAL_GEOCENTRE_M, tt, ut1.fraction)
    parts_m = [2.0 * wave(argument) @ series_m / len(tt) for wave in (np.cos, np.sin)]
    # The random epochs' noise of a series of 3 mm rms is 5e-5 m in an amplitude; three times that.
    np.testing.assert_allclose(parts_m, [in_phase_m, cross_phase_m], rtol=0.0, atol=1.5e-4)


def test_displacement_is_turned_into_the_itrf() -> None:
    station_m = itrf_from_geodetic(0.3, 0.7, 500.0)
    found_m = rot_itrf_to_enu(station_m) @ loading_itrf_m(SHANGHAI, station_m)
    np.testing.assert_allclose(found_m, loading_enu_m(SHANGHAI), rtol=0.0, atol=ROUNDING_M)


def test_dense_epochs_are_each_as_if_alone():
    """Many epochs share nodes between which the tides' modulation is interpolated; one alone does not."""
    tt = Epochs.from_jd(2459184.5, np.random.default_rng(2).uniform(0.0, 20.0, 2000), "TT")
    sums = sum_of_tides(loading_enu_m(SHANGHAI), tt, tt.fraction)
    single_sums = [sum_of_tides(loading_enu_m(SHANGHAI), tt[k], tt.fraction[k : k + 1]) for k in range(100)]
    assert np.abs(sums).max() > 5e-3
    np.testing.assert_allclose(sums[:100], np.concatenate(single_sums), rtol=0.0, atol=1e-11)
