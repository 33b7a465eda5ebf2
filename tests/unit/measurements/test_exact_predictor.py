"""Exact predictions: sizes of terms, time tags, links, partials and reasons for unusable observations."""

import numpy as np
import pytest
from arc_cases import APOLLO15, APOLLO15_PA_M, LASER, epochs_tai, observations, observed_at

from radioloc.constants import C_M_S
from radioloc.errors import CoverageError, InputError, StationError
from radioloc.measurements import TERMS, ExactPredictor, FixedPoint
from radioloc.media.medium import Status, describe
from radioloc.time import Epochs
from radioloc.time.scales import tdb_to_tt, tt_to_tai

# Values that are equal by definition agree to this; the rounding of a prediction is below half a micrometre.
SAME_M = 1e-6


@pytest.fixture(scope="module")
def radio(model):
    return model.without("troposphere")


def computed(model, path, tai, tag="transmit", pa_m=APOLLO15_PA_M, **columns):
    return ExactPredictor(model, observations(path, tai, tag, **columns), FixedPoint(pa_m)).compute()


# ---------------------------------------------------------------------------------------------------------------------
# Terms


# Lower and upper bound in metres of the contribution of each term to a round trip between Apache Point and
# Apollo 15, with the Moon up to 90 degrees from the meridian.
BOUNDS_M = {
    # 2 x (7.6 m by the Sun (1.7 % by the Earth's distance, 7 % by the Moon's) + 4 cm by the Earth), less than 1 mm by
    # Moon and planets.
    "shapiro": (13.8, 16.3),
    # c x 2.7 s x (3.3e-10 over the year + 1.3e-10 over the day), of either sign.
    "tdb_tt": (-0.38, 0.38),
    "galactic_aberration": (0.0, 0.0),
    "station_proper_time": (0.0, 0.0),  # UTC is kept
    "target_proper_time": (0.0, 0.0),  # not of a reflector
    # Twice 1.9 m at the zenith at 2.8 km, times up to 1/sin(20 deg).
    "troposphere": (3.2, 11.0),
    "ionosphere": (0.0, 0.0),
    # None given.
    "transponder_delay": (0.0, 0.0),
    "station_delay": (0.0, 0.0),
    "antenna_axis_offset": (0.0, 0.0),  # not of a telescope that ranges by laser
    # Up to 0.4 m up, so shorter, one way.
    "solid_earth_tide": (-0.85, 0.30),
    # 2 x 33 mm per arcsecond of the pole's 0.2 arcseconds.
    "pole_tide": (-0.014, 0.014),
    # No coefficients for Apache Point.
    "ocean_loading": (0.0, 0.0),
    "tidal_geocentre": (-0.03, 0.03),
    # 6.3 to 7.5 years of 14 mm a year, towards or away.
    "station_velocity": (-0.22, 0.22),
    "subdaily_eop": (-0.12, 0.12),
    # 2 x 2.47e-8 of the station's place along the line, which is at least sin(20 deg) of 6.37e6 m.
    "earth_scale": (0.09, 0.32),
    # 2 x up to 4.9e-9 of it.
    "earth_lorentz": (-0.063, 0.063),
    # Twice 0.49 m constant (cosine of 26 deg off the middle) and up to 0.2 m variable.
    "lunar_tide": (-1.3, -0.4),
    "lunar_tide_constant": (-0.80, -0.65),
    # 2 x 43 mm x cosine of 18 to 34 degrees between the reflector's vertical and the Earth.
    "lunar_scale": (0.068, 0.086),
    "lunar_lorentz": (-0.001, 0.018),
}


@pytest.fixture(scope="module")
def apollo_terms(model):
    """Return terms for elevations above 20 degrees over 13 months in steps of a day and 50 minutes."""
    tai = Epochs.from_jd(2453832.5, 1.0347 * np.arange(400), "TAI")
    table = observations(
        "APOLLO>apollo15>APOLLO", Epochs.concatenate([tai, tai.shifted(-6 * 3600.0)]), **LASER
    )
    elevation_rad = ExactPredictor(model, table, APOLLO15).compute().elevation_rad
    high = table.select(elevation_rad.min(axis=1) > np.radians(20.0))
    assert len(high) > 150
    return ExactPredictor(model, high, APOLLO15).terms()


@pytest.mark.parametrize("term", TERMS)
def test_size_of_each_term(apollo_terms, term):
    lower, upper = BOUNDS_M[term]
    value = apollo_terms[term]
    assert value.min() >= lower
    assert value.max() <= upper
    # A term that is lost would be near zero.
    if lower < upper:
        assert np.abs(value).max() > 0.1 * max(abs(lower), abs(upper))


def test_combined_observations_are_refused(model):
    rows = observations("KASHI<x>JIAMUSI", epochs_tai(2, 1.0), "receive", kind="differenced_range")
    with pytest.raises(InputError, match="got combined ones"):
        ExactPredictor(model, rows, APOLLO15)


def test_terms_add_up(model):
    """The value less that without any terms is the sum of the terms, except for products of pairs.

    The Earth moves 1.5 mm in the light time of 15 m; displacements of 0.5 m change gradients of 1e-6.
    """
    table = observations("APOLLO>apollo15>APOLLO", epochs_tai(5, 3.0, 2454040.5, 0.35), **LASER)
    arc = ExactPredictor(model, table, APOLLO15)
    terms = arc.terms(APOLLO15)
    # The constant tide is a part of the tide and would count twice.
    total_m = sum(value for name, value in terms.items() if name != "lunar_tide_constant")
    without_terms_m = ExactPredictor(model.without(*TERMS), table, APOLLO15).compute().value_m
    np.testing.assert_allclose(arc.compute(APOLLO15).value_m - without_terms_m, total_m, rtol=0, atol=1e-5)


# ---------------------------------------------------------------------------------------------------------------------
# Links and time tags


@pytest.mark.parametrize("path", ["KASHI>x>KASHI", "KASHI>x>NEUQUEN", "NEUQUEN>x>JIAMUSI"])
def test_time_tags_give_the_same_path(radio, path):
    """A signal sent at t is received at t + range / c by the station clocks, over the same path."""
    tai = epochs_tai(9, 24.0)
    arc = ExactPredictor(radio, observations(path, tai, "transmit"), APOLLO15)
    sent = arc.compute(APOLLO15)
    received = computed(radio, path, tai.shifted(sent.value_m / C_M_S), "receive")
    assert np.abs(received.value_m - sent.value_m).max() < SAME_M
    # The bounce is tagged by a clock at the geocentre: its TDB less TDB - TT of the geocentre.
    solved, *_ = arc._solve()
    bounce = tt_to_tai(tdb_to_tt(arc._reference.shifted(solved.bounce_s)))
    bounced = computed(radio, path, bounce, "bounce")
    assert np.abs(bounced.value_m - sent.value_m).max() < SAME_M
    for same_path in (received, bounced):
        np.testing.assert_allclose(same_path.by_position_pa, sent.by_position_pa, rtol=0, atol=2e-5)
        np.testing.assert_allclose(same_path.elevation_rad, sent.elevation_rad, rtol=0, atol=1e-9)


# ---------------------------------------------------------------------------------------------------------------------
# Partials


# ---------------------------------------------------------------------------------------------------------------------
# Unusable observations


def test_below_the_horizon(radio, model):
    tai = epochs_tai(49, 48.0)
    for tested_model, weather in ((radio, {}), (model, LASER)):
        predicted = computed(tested_model, "KASHI>x>NEUQUEN", tai, **weather)
        below = predicted.elevation_rad < 0.0
        assert below.any()
        assert not below.all()
        code, text = describe(predicted.status, predicted.elevation_rad)
        assert ((code == Status.BELOW_HORIZON) == below.any(axis=1)).all()
        assert np.isfinite(predicted.value_m).all()
    lowest = np.degrees(predicted.elevation_rad[below[:, 0], 0])
    assert text[below[:, 0]][0] == f"below the horizon ({lowest[0]:.1f} deg)"


def test_below_three_degrees_only_the_troposphere_is_missing(model, radio):
    tai = epochs_tai(721, 24.0)
    predicted = computed(model, "GRASSE>x>GRASSE", tai, **LASER)
    elevation_deg = np.degrees(predicted.elevation_rad).min(axis=1)
    low = (elevation_deg > 0.0) & (elevation_deg < 3.0)
    assert low.sum() > 10
    assert all(
        "below 3 degrees" in text for text in describe(predicted.status, predicted.elevation_rad)[1][low]
    )
    assert predicted.usable[elevation_deg > 3.0].all()
    assert computed(radio, "GRASSE>x>GRASSE", tai).usable[low].all()


def test_unknown_station_names_file_and_line(radio):
    tai = epochs_tai(3, 1.0)
    table = observed_at(
        observations("KASHI>x>KASHI", tai).epoch,
        ["KASHI>x>KASHI", "KASHI>x>KASHGAN"],
        tag="transmit",
        link=[0, 0, 1],
        value_m=7e8,
        files=["pass.tdm"],
        line=[7, 8, 19],
    )
    with pytest.raises(StationError, match=r"pass\.tdm.*19:.*'KASHGAN'.*KASHI"):
        ExactPredictor(radio, table, APOLLO15)
    # Stations of unused links are not looked up.
    assert ExactPredictor(radio, table.select([0, 1]), APOLLO15).stations == ("KASHI",)


@pytest.mark.parametrize("date", ["2050-06-01", "2051-01-01"])
def test_epochs_outside_kernels_or_earth_orientation(radio, date):
    table = observed_at(date, "KASHI>x>KASHI", tag="transmit", value_m=7e8)
    with pytest.raises(CoverageError, match=r"kernel|Earth orientation|\.bsp"):
        ExactPredictor(radio, table, APOLLO15)


def test_empty_table_gives_empty_predictions(radio):
    empty = observations("KASHI>x>KASHI", epochs_tai(2, 1.0)).select(np.zeros(2, dtype=bool))
    predicted = ExactPredictor(radio, empty, APOLLO15).compute()
    assert predicted.value_m.shape == (0,)
    assert predicted.by_position_pa.shape == (0, 3)
