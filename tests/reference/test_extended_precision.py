"""The path of the signal in 40 digits, from barycentric vectors and the kernels' own coefficients.

What is shared with the library (TDB - TT and the rotation of the Earth, which only ERFA has) shows its noise in the
smoothness of successive ranges.
"""

import mpmath as mp
import numpy as np
import pytest
from arc_cases import APOLLO15, APOLLO15_PA_M, LASER, epochs_tai, observations
from forty_digits import DIGITS, FortyDigits, mpf

from radioloc.earth.stations import StationCatalogue
from radioloc.measurements import TERMS, ExactPredictor
from radioloc.measurements.registry import TIME_TAGS
from radioloc.time import Epochs, utc_to_tt

GOAL_M = 5e-5
"""What the numerical noise of a range has to stay below."""

# What is reached, with a margin: at 60 random epochs and paths 0.5 micrometres at most from 40 digits. Smoothness has
# also the Earth's rotation in it and the tides, 0.4 micrometres at most in 29 stretches of 2003 to 2024.
FROM_40_DIGITS_M = 2e-6
ROUGHNESS_M = 1e-6

GEOMETRIC_TERMS = ("tdb_tt", "earth_scale", "earth_lorentz", "lunar_scale", "lunar_lorentz")


CASES = [
    ("APOLLO", "APOLLO", "transmit", 2454040.5, 0.31),
    ("GRASSE", "GRASSE", "receive", 2460440.5, 0.77),
    ("KASHI", "JIAMUSI", "receive", 2459185.5, 0.62),
    ("NEUQUEN", "KASHI", "transmit", 2459186.5, 0.10),
    ("JIAMUSI", "NEUQUEN", "bounce", 2459187.5, 0.999),
]


@pytest.mark.parametrize(("sender", "receiver", "tag", "jd", "fraction"), CASES)
def test_path_against_40_digits(model, sender, receiver, tag, jd, fraction):
    fewer = model.without(*(set(TERMS) - {*GEOMETRIC_TERMS, "subdaily_eop"}))
    table = observations(f"{sender}>apollo15>{receiver}", Epochs.from_jd(jd, fraction, "TAI"), tag)
    ours_m = ExactPredictor(fewer, table, APOLLO15).compute().value_m[0]
    catalogue = StationCatalogue.default()
    with mp.workdps(DIGITS):
        exact_m = FortyDigits(fewer.terms).value_m(
            catalogue[sender].itrf_m, catalogue[receiver].itrf_m, APOLLO15_PA_M, tag, utc_to_tt(table.epoch)
        )
        difference_m = float(mpf(ours_m) - exact_m)
    assert abs(difference_m) < FROM_40_DIGITS_M < GOAL_M


@pytest.mark.parametrize("tag", TIME_TAGS)
@pytest.mark.parametrize(("path", "spacing_s"), [("GRASSE>x>GRASSE", 0.01), ("APOLLO>x>GRASSE", 1.0)])
def test_successive_ranges_are_smooth(model, tag, path, spacing_s):
    """The residuals of 101 ranges of all terms to a polynomial of low order are rounding noise."""
    count = 101
    tai = epochs_tai(count, spacing_s * (count - 1) / 3600.0, 2460310.5, 0.28)
    computed = ExactPredictor(model, observations(path, tai, tag, **LASER), APOLLO15).compute()
    assert computed.usable.all()
    elapsed_s = tai.seconds_since(tai[np.zeros(count, dtype=int)])
    # Counted from the first, which is exact: a fit to 7.7e8 m itself is rounded by 1 to 20 micrometres, by how the
    # linear algebra of the day orders its sums. Over 100 s what a fourth order leaves is far below a micrometre.
    grown_m = computed.value_m - computed.value_m[0]
    noise_m = grown_m - np.polynomial.Polynomial.fit(elapsed_s, grown_m, 4)(elapsed_s)
    assert np.abs(noise_m).max() < ROUGHNESS_M < GOAL_M
