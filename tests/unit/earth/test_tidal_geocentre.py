import numpy as np
import pytest

from radioloc.earth.ocean_loading import TIDAL_GEOCENTRE_M, sum_of_tides
from radioloc.errors import InputError
from radioloc.time import Epochs

DAYS = np.random.default_rng(3).uniform(0.0, 6798.4, 8000)
"""Epochs over a turn of the Moon's node, which leave 2 % of one tide in the estimate of another."""

UT1 = Epochs.from_jd(2456000.5, DAYS, "UT1")
TT = Epochs.from_jd(UT1.jd, UT1.fraction + 69.0 / 86400.0, "TT")

TOLERANCE_M = 1.5e-4
"""The random epochs' noise of a series of 3 mm rms is 5e-5 m in an amplitude; three times that."""


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
def test_holds_the_published_tides(argument_turns: object, in_phase_m: tuple, cross_phase_m: tuple) -> None:
    """Cosine and sine parts at the astronomical arguments that tide tables use."""
    centuries = TT.centuries_since_j2000()
    s = (218.3166 + 481267.8813 * centuries) / 360.0
    h = (280.4665 + 36000.7698 * centuries) / 360.0
    argument = 2.0 * np.pi * argument_turns(UT1.fraction, s, h)  # type: ignore[operator]
    series_m = sum_of_tides(TIDAL_GEOCENTRE_M, TT, UT1.fraction)
    np.testing.assert_allclose(
        2.0 * np.cos(argument) @ series_m / len(TT), in_phase_m, rtol=0.0, atol=TOLERANCE_M
    )
    np.testing.assert_allclose(
        2.0 * np.sin(argument) @ series_m / len(TT), cross_phase_m, rtol=0.0, atol=TOLERANCE_M
    )


def test_size() -> None:
    distance_m = np.linalg.norm(sum_of_tides(TIDAL_GEOCENTRE_M, TT, UT1.fraction), axis=-1)
    assert 0.010 < distance_m.max() < 0.020
    assert 0.003 < np.sqrt(np.mean(distance_m**2)) < 0.007


def test_wants_tt() -> None:
    with pytest.raises(InputError, match="TT"):
        sum_of_tides(TIDAL_GEOCENTRE_M, UT1, UT1.fraction)
