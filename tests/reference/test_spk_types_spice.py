"""States from segments of an SPK by type, and the choice among segments, against SPICE, which reads the same files."""

import numpy as np
import pytest
import spiceypy
from spk_files import ORBITER, TYPES, with_other_byte_order, write_random

from radioloc.ephemeris import Trajectory

# Random walks of some 20 km and km/s within hours of J2000, where one float resolves an epoch to 1e-12 s.
ROUNDING_KM = 1e-8


@pytest.mark.parametrize("big_endian", [False, True])
@pytest.mark.parametrize("spk_type", TYPES)
def test_states_of_each_type_and_overlapping_segments_are_those_of_spice(tmp_path, spk_type, big_endian):
    rng = np.random.default_rng(spk_type)
    # In the file's order: one inside another, one after a gap of 1000 s, one over the end of the first.
    spans_s = [(0.0, 9000.0), (2000.0, 3000.0), (14000.0, 20000.0), (8000.0, 13000.0), (2500.0, 2600.0)]
    path = write_random(tmp_path / "random.bsp", spk_type, spans_s, rng)
    if big_endian:
        path.write_bytes(with_other_byte_order(path.read_bytes()))
    trajectory = Trajectory.open(path, ORBITER)
    assert trajectory.spans_s() == [(0.0, 13000.0), (14000.0, 20000.0)]
    et_s = np.concatenate([rng.uniform(first_s, last_s, 300) for first_s, last_s in [*spans_s, spans_s[0]]])
    et_s = np.concatenate([et_s, np.ravel(spans_s)])
    spiceypy.furnsh(str(path))
    try:
        by_spice = np.array([spiceypy.spkgeo(ORBITER, et, "J2000", 301)[0] for et in et_s])
    finally:
        spiceypy.kclear()
    ours = trajectory.states(et_s, trajectory.segment_indices(et_s))
    assert np.abs(by_spice).max() > 1.0
    np.testing.assert_allclose(ours, by_spice, rtol=0, atol=ROUNDING_KM)
