import numpy as np

from radioloc.earth.ocean_loading import GIVEN_TIDES, amplitudes_by_given, sum_of_tides, tidal_potential
from radioloc.earth.stations import StationCatalogue
from radioloc.time import Epochs

ROUNDING_M = 1e-15


def test_table_of_thetidal_potential() -> None:
    multipliers, equilibrium_m = tidal_potential()
    assert multipliers.shape == (342, 6)
    assert len({tuple(row) for row in multipliers}) == 342
    assert np.abs(equilibrium_m).min() == 0.00005
    # Cartwright and Edden (1973): M2, S2, N2, K2, K1, O1, P1, Q1, Mf, Mm, Ssa.
    expected = (0.632208, 0.294107, 0.121046, 0.079915, 0.368645, -0.262232, -0.121995, -0.050208)
    expected += (-0.066607, -0.035184, -0.030988)
    found = [equilibrium_m[(multipliers == tide).all(axis=1)][0] for tide in GIVEN_TIDES]
    assert found == list(expected)


def test_given_tides_keep_their_amplitudes() -> None:
    loading = StationCatalogue.default()["SESHAN25"].ocean_loading
    assert loading is not None
    multipliers, _ = tidal_potential()
    columns = [int(np.flatnonzero((multipliers == tide).all(axis=1))[0]) for tide in GIVEN_TIDES]
    given_m = loading.amplitude_m * np.exp(-1j * loading.phase_lag_rad)
    found_m = np.abs((given_m @ amplitudes_by_given())[:, columns])
    np.testing.assert_allclose(found_m, loading.amplitude_m, rtol=0.0, atol=ROUNDING_M)


def test_equal_admittance_gives_the_equilibrium_tide() -> None:
    """Where the response is the same at all frequencies, every tide keeps its share of the potential."""
    multipliers, equilibrium_m = tidal_potential()
    given = [int(np.flatnonzero((multipliers == tide).all(axis=1))[0]) for tide in GIVEN_TIDES]
    amplitudes_m = np.tile(0.01 * np.abs(equilibrium_m[given]), (3, 1)).astype(complex)
    found_m = np.abs(amplitudes_m @ amplitudes_by_given())
    np.testing.assert_allclose(
        found_m, np.tile(0.01 * np.abs(equilibrium_m), (3, 1)), rtol=0.0, atol=ROUNDING_M
    )


def test_sum_repeats_with_the_nodal_modulation() -> None:
    """M2 alone is modulated by 3.7 % with the node's 18.6 years (Doodson and Warburg 1941)."""
    amplitudes_m = np.zeros((3, 11), dtype=complex)
    amplitudes_m[0, [0, 1, 2, 3]] = 0.632208, 0.294107, 0.121046, 0.079915
    amplitudes = np.abs((amplitudes_m @ amplitudes_by_given())[0])
    multipliers, _ = tidal_potential()
    side = (multipliers == (2, 0, 0, 0, -1, 0)).all(axis=1)
    assert abs(amplitudes[side][0] / 0.632208 - 0.0373) < 5e-4


def test_components_are_independent() -> None:
    tt = Epochs.from_jd(2459000.5, np.arange(10) / 10, "TT")
    amplitudes_m = np.zeros((3, 11), dtype=complex)
    amplitudes_m[1] = 0.01
    components_m = sum_of_tides(amplitudes_m, tt, tt.fraction)
    assert components_m.shape == (10, 3)
    assert (components_m[:, [0, 2]] == 0.0).all()
    assert (components_m[:, 1] != 0.0).all()
