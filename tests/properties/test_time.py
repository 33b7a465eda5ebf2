"""Round trips of time scales and dates, hunting for the worst epoch."""

from fractions import Fraction

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from radioloc.time import (
    Epochs,
    epochs_from_strings,
    tai_to_tt,
    tai_to_utc,
    tt_to_tdb,
    utc_strings,
    utc_to_tai,
)
from radioloc.time.scales import tdb_to_tt, tt_to_tai

# The last place of a fraction of a day just below one is 1.1e-16 d = 9.6e-12 s. A change of scale there and back
# rounds to it a few times.
FEW_LAST_PLACES_S = 3e-11
# Nine decimals of a second, rounded, and the fraction's last place.
NINE_DECIMALS_S = 0.5e-9 + FEW_LAST_PLACES_S

DAYS = st.integers(2441317, 2469806).map(lambda day: day + 0.5)  # 1972 to 2049
DAYS_WITH_LEAP_SECOND = st.sampled_from([2441498.5, 2441682.5, 2453735.5, 2456108.5, 2457203.5, 2457753.5])
NEAR_MIDNIGHT = st.one_of(
    st.floats(0.0, 1e-9),
    st.floats(1.0 - 1e-9, 1.0, exclude_max=True),
    st.floats(0.99998, 1.0, exclude_max=True),
)
FRACTIONS = st.one_of(st.floats(0.0, 1.0, exclude_max=True), NEAR_MIDNIGHT)
ALL_DAYS = st.one_of(DAYS, DAYS_WITH_LEAP_SECOND)


@given(ALL_DAYS, FRACTIONS)
def test_utc_to_tai_and_back(jd, fraction):
    tai = utc_to_tai(Epochs.from_jd(jd, fraction, "UTC"))
    round_trip = utc_to_tai(tai_to_utc(tai))
    assert abs(round_trip.seconds_since(tai)[0]) < FEW_LAST_PLACES_S


@given(ALL_DAYS, FRACTIONS)
def test_tai_to_tdb_and_back(jd, fraction):
    tai = Epochs.from_jd(jd, fraction, "TAI")
    back = tt_to_tai(tdb_to_tt(tt_to_tdb(tai_to_tt(tai))))
    assert abs(back.seconds_since(tai)[0]) < FEW_LAST_PLACES_S


@given(ALL_DAYS, FRACTIONS)
def test_dates_as_text_and_back(jd, fraction):
    utc = Epochs.from_jd(jd, fraction, "UTC")
    text = utc_strings(utc)
    read = epochs_from_strings(text.tolist(), "UTC")
    assert abs(utc_to_tai(read).seconds_since(utc_to_tai(utc))[0]) < NINE_DECIMALS_S
    assert utc_strings(read).tolist() == text.tolist()


@given(
    st.floats(2.4e6, 2.5e6),
    st.floats(-2.0, 2.0),
    st.floats(-1e6, 1e6),
    st.sampled_from(["TAI", "TT", "TDB", "UT1"]),
)
def test_normal_form_and_shift_lose_nothing(jd, fraction, seconds, scale):
    epochs = Epochs.from_jd(jd, fraction, scale)
    exact_days = Fraction(jd) + Fraction(fraction)
    kept_days = Fraction(float(epochs.jd[0])) + Fraction(float(epochs.fraction[0]))
    assert abs(float(kept_days - exact_days)) * 86400.0 < FEW_LAST_PLACES_S
    assert 0.0 <= epochs.fraction[0] < 1.0
    assert np.mod(epochs.jd[0], 1.0) == 0.5
    # A shift of 1e6 s has its own last place, 1.2e-10 s.
    moved = epochs.shifted(seconds).seconds_since(epochs)[0]
    assert abs(moved - seconds) < FEW_LAST_PLACES_S + 3e-16 * abs(seconds)
