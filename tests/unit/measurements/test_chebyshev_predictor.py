"""Interpolated arcs agree with exact ones within their stated errors, for all forms of series."""

import numpy as np
import pytest
from arc_cases import (
    APOLLO15,
    APOLLO15_PA_M,
    LASER,
    assert_same,
    epochs_tai,
    observations,
    with_predictions_after_2_december,
)
from quick import some

from radioloc.constants import C_M_S
from radioloc.errors import InputError, PredictedEopWarning
from radioloc.lunar import selenographic_to_cartesian
from radioloc.measurements import FixedPoint, chebyshev_predictor
from radioloc.measurements.chebyshev_predictor import ChebyshevPredictor
from radioloc.measurements.evaluation import prepare_predictor
from radioloc.measurements.exact_predictor import ExactPredictor
from radioloc.measurements.observations import Observations
from radioloc.measurements.physical_model import PhysicalModel
from radioloc.media.ionosphere import UniformTec
from radioloc.time import Epochs, epochs_from_strings, utc_to_tai

# Stated error of interpolated arcs: 0.3 ps of delay or the same in range.
ALLOWED_M = 0.3e-12 * C_M_S
# Error of partials relative to the largest partial of the same column.
ALLOWED_RELATIVE = 1e-6
ALLOWED_RAD = 1e-6
# Rounding of partials, which dominates for short count intervals and for by_time on short baselines.
ROUNDING = {
    "by_position_pa": 4e-12,
    "by_time_m_s": 2e-6,
    "by_transponder_delay_m_s": 2e-5,
    "by_zenith_wet": 4e-9,
}
# Rounding of an exact range that is computed in blocks or in a selection.
SAME_M = 1e-6


def series(path, kind, tai, **columns):
    return observations(path, tai, "transmit" if kind == "range" else "receive", kind, **columns)


def mixed(step_s=30.0, hours=8.0, start_fraction=0.6):
    """Return a night of two- and three-way ranges, delays and Doppler of stations in China."""
    tai = epochs_tai(int(hours * 3600.0 / step_s), hours, start_fraction=start_fraction)
    return Observations.concatenate(
        [
            series("KASHI>x>KASHI", "range", tai, wavelength_um=35000.0),
            series("JIAMUSI>x>KASHI", "range", tai),
            series("SESHAN25<x>URUMQI", "vlbi_delay", tai),
            series("KASHI>x>JIAMUSI", "doppler", tai, count_s=60.0),
        ]
    )


def assert_agree(arc, position_pa_m, count=150, seed=1, model=None):
    """Assert that random rows agree with exact ones within the stated errors and have the same status."""
    rows = np.random.default_rng(seed).permutation(len(arc.observations))[:count]
    part = arc.observations.select(rows)
    exact = ExactPredictor(model or arc.model, part, FixedPoint(position_pa_m)).compute()
    interpolated = arc.predict(FixedPoint(position_pa_m)).rows(rows)
    assert (interpolated.status == exact.status).all()
    assert np.abs(interpolated.value_m - exact.value_m).max() < ALLOWED_M
    assert np.abs(arc.predict(FixedPoint(position_pa_m)).value_m[rows] - exact.value_m).max() < ALLOWED_M
    assert np.abs(interpolated.elevation_rad - exact.elevation_rad).max() < ALLOWED_RAD
    for name, rounding in ROUNDING.items():
        partials, expected = getattr(interpolated, name), getattr(exact, name)
        for link in np.unique(part.link):
            of_link = part.link == link
            limit = max(ALLOWED_RELATIVE * np.abs(expected[of_link]).max(), rounding)
            assert np.abs(partials[of_link] - expected[of_link]).max() < limit, name


@pytest.mark.parametrize(
    ("longitude_deg", "latitude_deg"),
    some([(3.6, 26.1), (88.0, -5.0), (-51.9, 43.1), (0.0, -89.5)], [(3.6, 26.1), (0.0, -89.5)]),
)
def test_dense_series_agree_with_the_exact_arc(model, longitude_deg, latitude_deg):
    point_pa_m = selenographic_to_cartesian(np.radians(longitude_deg), np.radians(latitude_deg), 0.0)
    arc = ChebyshevPredictor(model, mixed(), FixedPoint(point_pa_m))
    assert_agree(arc, point_pa_m)
    accuracy = arc.accuracy
    assert accuracy.interpolated > 0.9 * len(arc.observations)
    # The interpolation error is below the rounding of the ranges.
    assert accuracy.range_m < 1e-5
    assert accuracy.delay_s < 1e-14
    assert accuracy.integrated_m < 1e-5
    assert 10 * accuracy.nodes < accuracy.interpolated


def test_recorded_weather_splits_series(model):
    tai = epochs_tai(5 * 720, 5.0, start_fraction=0.75)
    rows = np.arange(len(tai))
    # Weather changes every half hour at one station and with every observation at the other.
    weather = LASER | {"temperature_k": 280.0 + (rows // 360) % 3, "pressure_hpa": 780.0 + (rows // 360) % 2}
    table = Observations.concatenate(
        [
            series("GRASSE>x>GRASSE", "range", tai, **weather),
            series("KASHI>x>KASHI", "range", tai, temperature_k=280.0 + 0.001 * rows, pressure_hpa=850.0),
        ]
    )
    arc = ChebyshevPredictor(model, table, APOLLO15)
    assert_agree(arc, APOLLO15_PA_M)
    assert arc.accuracy.exact >= len(tai)
    # Without refraction in the model weather has no effect.
    dry = ChebyshevPredictor(model.without("troposphere"), table, APOLLO15)
    assert dry.accuracy.exact < 100
    assert_agree(dry, APOLLO15_PA_M)


class KinkedTec:
    """Electron content with a corner every twenty minutes, as at the cell borders of maps."""

    def slant_tec(self, station_itrf_m, azimuth_rad, elevation_rad, epochs):
        phase = (epochs.fraction * 72.0) % 1.0
        return 10.0 + 20.0 * np.abs(phase - 0.5)


@pytest.mark.parametrize("content", [UniformTec(30.0), KinkedTec()])
def test_ionosphere(content):
    model = PhysicalModel.build(ionosphere=content)
    tai = epochs_tai(7200, 4.0, start_fraction=0.7)
    columns = {"wavelength_um": 130000.0, "uplink_hz": 2.1e9}
    table = series("KASHI>x>KASHI", "range", tai, **columns)
    arc = ChebyshevPredictor(model, table, APOLLO15)
    assert_agree(arc, APOLLO15_PA_M, count=800)
    if isinstance(content, KinkedTec):
        # Rows near a corner are computed exactly, the others are interpolated.
        assert 0.0 < arc.accuracy.exact < 0.4 * len(table)
    else:
        assert arc.accuracy.exact == 0


def test_leap_second_and_midnights(model):
    """Over the end of 2016: the last minute has 61 seconds, and Earth orientation is tabulated at each 0h."""
    middle = utc_to_tai(epochs_from_strings("2016-12-31T23:59:60.5", "UTC"))
    offset_s = np.arange(-7200.0, 7200.0, 4.0)
    tai = Epochs.from_jd(np.full(len(offset_s), middle.jd[0]), middle.fraction[0] + offset_s / 86400.0, "TAI")
    table = series("NEUQUEN>x>NEUQUEN", "range", tai)
    arc = ChebyshevPredictor(model.without("troposphere"), table, APOLLO15)
    # The Moon sets at the end.
    assert arc.accuracy.exact < 100
    assert_agree(arc, APOLLO15_PA_M, count=400)


def untidy():
    """Return a table with gaps, a single observation, duplicate epochs and no order."""
    tai = epochs_tai(1200, 6.0, start_fraction=0.6)
    chosen = np.ones(1200, dtype=bool)
    chosen[300:420] = chosen[500:503] = False
    gappy = tai[np.flatnonzero(chosen)]
    single = Epochs.from_jd(tai.jd[:1] + 1.0, tai.fraction[:1], "TAI")
    table = Observations.concatenate(
        [
            series("KASHI>x>KASHI", "range", gappy),
            series("KASHI>x>KASHI", "range", gappy[np.arange(40, 60)]),
            series("SESHAN25<x>URUMQI", "vlbi_delay", gappy),
            series("KASHI>x>KASHI", "range", single),
        ]
    )
    return table.select(np.random.default_rng(7).permutation(len(table)))


def test_untidy_series(model):
    table = untidy()
    arc = ChebyshevPredictor(model, table, APOLLO15)
    assert_agree(arc, APOLLO15_PA_M, count=500)
    assert 1 <= arc.accuracy.exact < 20
    exact = ExactPredictor(model, table, APOLLO15)
    assert arc.stations == exact.stations
    assert (arc.transmitters == exact.transmitters).all()
    assert (arc.receivers == exact.receivers).all()
    # The result does not depend on the order of the rows, to the last bit.
    order = np.argsort(utc_to_tai(table.epoch).mjd, kind="stable")
    sorted_arc = ChebyshevPredictor(model, table.select(order), APOLLO15)
    assert_same(sorted_arc.compute(APOLLO15), arc.compute(APOLLO15).rows(order))


@pytest.fixture(scope="module")
def untidy_arc(model):
    return ChebyshevPredictor(model, untidy(), APOLLO15)


@pytest.mark.parametrize("selection", ["mask", "indices", "slice", "step"])
def test_rows_and_select(untidy_arc, selection):
    n = len(untidy_arc.observations)
    rows = {
        "mask": np.arange(n) % 3 == 1,
        "indices": np.random.default_rng(3).integers(0, n, 400),
        "slice": slice(100, 900),
        "step": slice(None, None, -2),
    }[selection]
    full = untidy_arc.compute(APOLLO15)
    assert_same(untidy_arc.predict(APOLLO15).rows(rows), full.rows(rows))
    part = untidy_arc.select(rows)
    assert_same(part.compute(APOLLO15), full.rows(rows))
    assert (part.predict(APOLLO15).value_m == full.value_m[rows]).all()
    assert part.accuracy.interpolated + part.accuracy.exact == len(full.value_m[rows])
    assert (part.observations.link == untidy_arc.observations.link[rows]).all()
    assert_same(part.select([5]).compute(APOLLO15), part.compute(APOLLO15).rows([5]))


def test_threads_do_not_change_a_bit(untidy_arc, monkeypatch):
    numba = pytest.importorskip("numba")
    computed = []
    for threads in (1, 2, 3):
        monkeypatch.setattr(numba.config, "NUMBA_NUM_THREADS", threads)
        monkeypatch.setattr(chebyshev_predictor, "_MIN_ROWS_PER_THREAD", 100)
        computed.append(untidy_arc.compute(APOLLO15))
    assert_same(computed[0], computed[1])
    assert_same(computed[0], computed[2])


def test_positions_far_from_the_one_prepared(model):
    """Segments are checked again for a distant position; a change of position is part of the polynomials."""
    arc = ChebyshevPredictor(model, mixed(60.0, 4.0), APOLLO15)
    original = arc.compute(APOLLO15)
    for offset_m in ([3e3, -2e3, 1e3], [-2e5, 1e5, 3e5]):
        assert_agree(arc, APOLLO15_PA_M + np.array(offset_m))
    other_side_m = np.array([-1.0, 1.0, 1.0]) * APOLLO15_PA_M
    assert_agree(arc, other_side_m)
    assert_same(arc.compute(APOLLO15), original, atol=SAME_M)
    with pytest.raises(InputError):
        arc.compute(np.array([np.nan, 0.0, 0.0]))


def test_predicted_earth_orientation(model):
    """Observations after the midnight of the last measured Earth orientation are marked."""
    predicted_model = with_predictions_after_2_december(model)
    tai = epochs_tai(1440, 12.0, start_jd=2459184.5, start_fraction=0.75)
    rows = series("KASHI>x>KASHI", "range", tai)
    with pytest.warns(PredictedEopWarning):
        arc = ChebyshevPredictor(predicted_model, rows, APOLLO15)
    with pytest.warns(PredictedEopWarning):
        exact = ExactPredictor(predicted_model, rows, APOLLO15)
    assert (arc.predicted_eop == exact.predicted_eop).all()
    assert 0 < arc.predicted_eop.sum() < len(rows)


def test_terms(model):
    table = mixed(120.0, 3.0)
    reduced_model = model.without(*(set(model.terms) - {"solid_earth_tide", "troposphere"}))
    terms = ChebyshevPredictor(reduced_model, table, APOLLO15).terms()
    exact = ExactPredictor(reduced_model, table, APOLLO15).terms()
    assert list(terms) == list(exact)
    for name, value_m in exact.items():
        assert np.abs(terms[name] - value_m).max() < 2 * ALLOWED_M


def test_choice_of_evaluation(model):
    dense, sparse = mixed(10.0, 4.0), mixed(600.0, 4.0)
    assert isinstance(prepare_predictor(model, dense, APOLLO15), ChebyshevPredictor)
    assert isinstance(prepare_predictor(model, sparse, APOLLO15), ExactPredictor)
    assert isinstance(prepare_predictor(model, sparse, APOLLO15, "exact"), ExactPredictor)
    forced = prepare_predictor(model, sparse, APOLLO15, "interpolated")
    assert isinstance(forced, ChebyshevPredictor)
    assert forced.accuracy.interpolated == 0
    with pytest.raises(InputError, match="got 'fast'"):
        prepare_predictor(model, sparse, APOLLO15, "fast")


def test_kernel_with_more_paths_than_bins():
    """Many alternating segments of several degrees; leading zero coefficients have no effect."""
    pytest.importorskip("numba")
    from radioloc.measurements import _kernels

    random = np.random.default_rng(9)
    n, segments = 3 * _kernels.GROUP_SIZE, 3 * _kernels.BIN_COUNT
    segment = random.integers(0, segments, n).astype(np.int32)
    x = random.uniform(-1.0, 1.0, n)
    coefficients = random.normal(size=(segments, 2, 17))
    coefficients[::2, :, :6] = 0.0
    coefficients[::5, 1] = 0.0
    computed = np.full((2, n), np.nan)
    _kernels.quantities(segment, x, coefficients, computed, 0, n)
    expected = coefficients[segment, :, 0].T.copy()
    for k in range(1, 17):
        expected = expected * x + coefficients[segment, :, k].T
    np.testing.assert_array_equal(computed, expected)
