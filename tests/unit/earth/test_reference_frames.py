"""Earlier terrestrial frames against PROJ, and the antennas of the Deep Space Network against VLBI."""

import numpy as np
import pytest

from radioloc.earth.stations import StationCatalogue, frames, to_itrf2020
from radioloc.time import Epochs

PLACE_M = np.array([-2354906.711, -4646840.095, 3669242.325])
PRINTED_M = 6e-6
"""PROJ's numbers below have five decimals."""

# pyproj.transformer.TransformerGroup(f"EPSG:{code}", "EPSG:9988").transformers[0].transform(*PLACE_M, 2024.5), pyproj
# 3.7.2 with the parameters of the EPSG; codes 4915 to 4919 (ITRF93, 94, 96, 97, 2000), 4896, 5332, 7789.
BY_PROJ_M = {
    "ITRF93": (-2354906.52813, -4646840.13114, 3669242.36837),
    "ITRF94": (-2354906.71878, -4646840.05533, 3669242.41356),
    "ITRF96": (-2354906.71878, -4646840.05533, 3669242.41356),
    "ITRF97": (-2354906.71878, -4646840.05533, 3669242.41356),
    "ITRF2000": (-2354906.70399, -4646840.08049, 3669242.36326),
    "ITRF2005": (-2354906.71435, -4646840.08981, 3669242.32202),
    "ITRF2008": (-2354906.71121, -4646840.09507, 3669242.32077),
    "ITRF2014": (-2354906.71059, -4646840.09510, 3669242.32324),
    "ITRF2020": tuple(PLACE_M),
}

# GSFC's VLBI solution 2019d in ITRF2014, as in the list of antennas of the DiFX correlator: at 2020.0, by the positions
# of KUNMING and SESHAN25, which are those of the catalogue five years of their velocities later.
GSFC_2019D_M = {
    "DSS-13": (-2351112.9506, -4655530.5460, 3660912.6356),
    "DSS-15": (-2353539.2278, -4641649.3331, 3676669.8681),
    "DSS-34": (-4461147.7340, 2682439.2728, -3674392.2725),
    "DSS-36": (-4461169.0553, 2682814.7047, -3674083.0790),
    "DSS-45": (-4460936.2219, 2682765.7129, -3674380.1486),
    "DSS-65": (4849339.4917, -360427.3685, 4114750.9317),
}
DSN_M = 0.1
"""What 810-005 states of coordinates at 2003.0 (0.03 to 0.1 m), and 17 years of its velocities (2 mm/yr)."""
AT_2020 = Epochs.from_jd(2451545.0 + 20 * 365.25, 0.0, "TT")


@pytest.mark.parametrize("frame", BY_PROJ_M)
def test_positions_are_those_of_proj(frame):
    found_m, _ = to_itrf2020(frame, PLACE_M, np.zeros(3), 2024.5)
    np.testing.assert_allclose(found_m, BY_PROJ_M[frame], rtol=0.0, atol=PRINTED_M)


@pytest.mark.parametrize("frame", frames())
def test_a_velocity_is_the_change_of_the_position(frame):
    given_m_yr = np.array([-0.018, 0.0065, -0.0038])
    positions_m = [
        to_itrf2020(frame, PLACE_M + years * given_m_yr, given_m_yr, 2010.0 + years)[0] for years in (-10, 10)
    ]
    _, velocity_m_yr = to_itrf2020(frame, PLACE_M, given_m_yr, 2010.0)
    # Scale and rotation of what moved by 0.4 m: 1e-8 of it.
    np.testing.assert_allclose(np.diff(positions_m, axis=0)[0] / 20.0, velocity_m_yr, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("name", GSFC_2019D_M)
def test_dsn_antennas_are_where_vlbi_finds_them_by_the_rotations_of_itrf93_alone(name):
    station = StationCatalogue.default().get(name)
    vlbi_m, _ = to_itrf2020("ITRF2014", np.array(GSFC_2019D_M[name]), np.zeros(3), 2020.0)
    assert np.linalg.norm(station.position_at(AT_2020)[0] - vlbi_m) < DSN_M
    moved_m = station.itrf_m + 17.0 * station.velocity_m_yr
    by_all_m, _ = to_itrf2020("ITRF93", moved_m, station.velocity_m_yr, 2020.0)
    assert np.linalg.norm(by_all_m - vlbi_m) > 1.2 * DSN_M
