import numpy as np
import pytest

from radioloc.earth.blq import CONSTITUENTS, BlqCoefficients
from radioloc.earth.geodesy import itrf_from_geodetic, rot_itrf_to_enu
from radioloc.earth.ocean_loading import loading_enu_m, loading_itrf_m, sum_of_tides
from radioloc.earth.stations import StationCatalogue
from radioloc.errors import InputError
from radioloc.time import Epochs

ROUNDING_M = 1e-15

HOURS = np.arange(0.0, 400.0, 1.0)
UT1 = Epochs.from_jd(2459000.5, HOURS / 24.0, "UT1")
TT = Epochs.from_jd(UT1.jd, UT1.fraction + 69.0 / 86400.0, "TT")


def ocean_loading_enu(coefficients, tt, ut1_fraction):
    return sum_of_tides(loading_enu_m(coefficients), tt, ut1_fraction)


def make_coefficients(row: int, constituent: str, amplitude_m: float, lag_rad: float) -> BlqCoefficients:
    amplitude, lag = np.zeros((2, 3, 11))
    amplitude[row, CONSTITUENTS.index(constituent)] = amplitude_m
    lag[row, CONSTITUENTS.index(constituent)] = lag_rad
    return BlqCoefficients("TEST", amplitude, lag, "test")


@pytest.mark.parametrize(("row", "enu"), [(0, (0, 0, 1)), (1, (-1, 0, 0)), (2, (0, -1, 0))])
def test_rows_are_up_west_south(row: int, enu: tuple[int, int, int]) -> None:
    displacement_m = ocean_loading_enu(make_coefficients(row, "M2", 0.01, 0.0), TT, UT1.fraction)
    axis = int(np.argmax(np.abs(enu)))
    np.testing.assert_allclose(np.delete(displacement_m, axis, axis=1), 0.0, rtol=0.0, atol=ROUNDING_M)
    # M2 of zero lag is highest when the mean Moon is in the meridian of Greenwich: tau = 0.
    tau_turns = UT1.fraction - ((TT.centuries_since_j2000() * 445267.1114469 + 297.8501954694) / 360.0)
    m2_m = np.cos(4.0 * np.pi * tau_turns)
    assert np.corrcoef(displacement_m[:, axis], enu[axis] * m2_m)[0, 1] > 0.97


@pytest.mark.parametrize(
    ("constituent", "argument_turns"),
    [
        # As tide tables have them, with the hours counted from midnight (Schwiderski 1983).
        ("K1", lambda ut1, s, h: ut1 + h + 0.25),
        ("O1", lambda ut1, s, h: ut1 + h - 2 * s - 0.25),
        ("MF", lambda ut1, s, h: 2 * s),
    ],
)
def test_lags_count_from_the_equilibrium_tide(constituent: str, argument_turns: object) -> None:
    """The tide of zero lag goes with the astronomical argument of tide tables.

    Epochs at random over a turn of the node, of 18.6 years, leave 2 % of the other tides.
    """
    days = np.random.default_rng(1).uniform(0.0, 6798.4, 8000)
    ut1 = Epochs.from_jd(2456000.5, days, "UT1")
    tt = Epochs.from_jd(ut1.jd, ut1.fraction + 69.0 / 86400.0, "TT")
    centuries = tt.centuries_since_j2000()
    s = (218.3166 + 481267.8813 * centuries) / 360.0
    h = (280.4665 + 36000.7698 * centuries) / 360.0
    expected = np.cos(2.0 * np.pi * argument_turns(ut1.fraction, s, h))  # type: ignore[operator]
    up_m = ocean_loading_enu(make_coefficients(0, constituent, 0.01, 0.0), tt, ut1.fraction)[:, 2]
    lagged_m = ocean_loading_enu(make_coefficients(0, constituent, 0.01, np.pi / 2), tt, ut1.fraction)[:, 2]
    amplitude_m = 2.0 * np.mean(up_m * expected)
    assert amplitude_m == pytest.approx(0.01, rel=0.06)
    assert abs(2.0 * np.mean(lagged_m * expected)) < 0.06 * amplitude_m


def test_is_linear_in_the_coefficients() -> None:
    loading = StationCatalogue.default()["GRASSE"].ocean_loading
    assert loading is not None
    doubled = BlqCoefficients("TWICE", 2.0 * loading.amplitude_m, loading.phase_lag_rad, "test")
    np.testing.assert_allclose(
        ocean_loading_enu(doubled, TT, UT1.fraction),
        2.0 * ocean_loading_enu(loading, TT, UT1.fraction),
        rtol=0.0,
        atol=ROUNDING_M,
    )


def test_displacement_is_turned_into_the_itrf() -> None:
    loading = StationCatalogue.default()["MATERA"].ocean_loading
    assert loading is not None
    station_m = itrf_from_geodetic(0.3, 0.7, 500.0)
    enu_m = ocean_loading_enu(loading, TT, UT1.fraction)
    itrf_m = sum_of_tides(loading_itrf_m(loading, station_m), TT, UT1.fraction)
    np.testing.assert_allclose(itrf_m @ rot_itrf_to_enu(station_m).T, enu_m, rtol=0.0, atol=ROUNDING_M)


def test_wants_tt() -> None:
    loading = make_coefficients(0, "M2", 0.01, 0.0)
    with pytest.raises(InputError, match="TT"):
        ocean_loading_enu(loading, UT1, UT1.fraction)


def test_dense_epochs_are_each_as_if_alone():
    """Many epochs share nodes between which the tides' modulation is interpolated; one alone does not."""
    tt = Epochs.from_jd(2459184.5, np.random.default_rng(2).uniform(0.0, 20.0, 2000), "TT")
    coefficients = StationCatalogue.default().get("SESHAN25").ocean_loading
    together = ocean_loading_enu(coefficients, tt, tt.fraction)
    alone = [ocean_loading_enu(coefficients, tt[k], tt.fraction[k : k + 1]) for k in range(100)]
    assert np.abs(together).max() > 5e-3
    np.testing.assert_allclose(together[:100], np.concatenate(alone), rtol=0.0, atol=1e-11)
