"""Time-correlated residuals: found where they are, in the right numbers, and nothing else touched."""

from dataclasses import replace

import numpy as np
import pytest
from delay_network import DelayNetwork

from radioloc.estimation import Labels, Parameter, ParameterSet
from radioloc.estimation.editing import fit_with_editing
from radioloc.estimation.least_squares import fit_least_squares
from radioloc.estimation.series import MAX_POINTS, SeriesOrder, independent_series, points_of
from radioloc.estimation.time_correlation import assess_time_correlation, estimated_covariance
from radioloc.noise import ALONE
from radioloc.noise.whitening import column
from radioloc.simulation.noise import gauss_markov

STEP_S = 60.0
TAU_S = 3600.0


def assessed(fit, types, paths, time_s):
    return assess_time_correlation(fit, SeriesOrder.from_labels(types, paths, time_s))


def labels(n, text):
    return Labels(np.zeros(n, dtype=np.int32), (text,))


def line(n=1200, series=2, coloured=1.0, seed=0, **prior):
    """Straight lines through noise of several stations at the same instants."""
    rng = np.random.default_rng(seed)
    time_s = np.repeat(STEP_S * np.arange(n), series)
    path = Labels(np.tile(np.arange(series, dtype=np.int32), n), tuple(f"S{k}" for k in range(series)))
    error = rng.normal(size=n * series)
    for k in range(series):
        error[k::series] += coloured * gauss_markov(rng.normal(size=n), np.exp(-STEP_S / TAU_S))
    error /= np.hypot(1.0, coloured)
    design = np.column_stack([np.ones(n * series), np.linspace(-1.0, 1.0, n * series)])
    parameters = ParameterSet([Parameter("a", "m", "p", **prior), Parameter("b", "m", "p")])
    fit = fit_least_squares(lambda x: (error - design @ x, design), parameters, 1.0)
    return fit, labels(n * series, "range"), path, time_s


def test_numbers_of_a_known_process():
    result = assessed(*line(n=6000))
    assert [item.name for item in result.series] == ["range S0", "range S1"]
    for item in result.series:
        assert item.count == 6000
        # 200 correlation times of noise: some ten per cent.
        assert item.share == pytest.approx(0.5, abs=0.08)
        assert item.correlation_time_s == pytest.approx(TAU_S, rel=0.35)
        # Of n observations step apart, the mean has the variance (w + c 2 tau / step) / n.
        expected = 6000 / (0.5 + 0.5 * 2.0 * TAU_S / STEP_S)
        assert item.effective_count == pytest.approx(expected, rel=0.35)


def test_white_residuals_are_left_alone():
    assert assessed(*line(coloured=0.0)).series == ()


def test_an_undetermined_parameter_stays_undetermined():
    """Two that cannot be told apart have neither a variance that is known nor a part of it that is added."""
    fit, types, path, time_s = line()
    design = fit.linearization.partials(np.arange(len(time_s)))[:, [0, 1, 1]]
    parameters = ParameterSet([*fit.parameters, Parameter("c", "m", "p")])
    residual = fit.residual_m
    wider = fit_least_squares(lambda x: (residual - design @ x, design), parameters, 1.0)
    result = assessed(wider, types, path, time_s)
    assert (result.added_covariance[1:] == 0.0).all()
    assert result.added_covariance[0, 0] > 0.0


def test_the_covariance_of_an_estimate_has_what_time_correlation_adds():
    for coloured in (0.0, 1.0):
        fit, types, path, time_s = line(coloured=coloured)
        design = fit.linearization.partials(np.arange(len(time_s)))
        edited = fit_with_editing(lambda x: (fit.residual_m - design @ x, design), fit.parameters, 1.0)  # noqa: B023
        covariance, correlation = estimated_covariance(edited, SeriesOrder.from_labels(types, path, time_s))
        added = covariance - edited.fit.covariance
        if coloured:
            np.testing.assert_allclose(added, correlation.added_covariance, rtol=1e-9, atol=1e-18)
            assert (np.diag(added) > 5.0 * np.diag(edited.fit.covariance)).all()
        else:
            assert correlation is None
            # Processes that are not excluded add a little.
            assert (np.diag(added) >= 0.0).all()
            assert (np.diag(added) < 0.1 * np.diag(edited.fit.covariance)).all()


def test_long_series_are_averaged_and_gaps_take_no_bins():
    fit, types, path, time_s = line(n=3000, series=1)
    time_s = time_s + np.where(time_s > time_s.mean(), 1e7, 0.0)
    series = independent_series(SeriesOrder.from_labels(types, path, time_s), fit.noise, fit.used)
    binned = points_of(series, column(fit.residual_m))
    assert len(binned.step_s) == pytest.approx(MAX_POINTS, abs=5)
    assert (binned.gain**2).sum() == 3000
    assert (binned.step_s[1:] > 0.0).all()
    assert binned.width_s == pytest.approx(3000 * STEP_S / MAX_POINTS, rel=0.01)
    assert (binned.gain * binned.residual).sum() == pytest.approx(fit.residual_m.sum(), abs=1e-6)
    assert binned.squares == pytest.approx(fit.residual_m @ fit.residual_m)
    # No bin across the gap.
    assert (binned.step_s > 2.0 * binned.width_s).sum() == 1
    assert binned.step_s.max() == pytest.approx(1e7, rel=1e-3)


def delays_with_lasting_errors(stated_m, station_m, epochs=1500, scale=1.0):
    """Time correlation of delays of four stations with errors that last, for scaled sigmas of the baselines."""
    network = DelayNetwork.make(epochs=epochs, station_m=stated_m)
    rng = np.random.default_rng(5)
    stations = np.column_stack(
        [gauss_markov(rng.normal(size=epochs), np.exp(-STEP_S / TAU_S)) for _ in range(4)]
    )
    of_stations = stations[network.epoch, network.second] - stations[network.epoch, network.first]
    observed_m = network.own_m * rng.normal(size=len(network.epoch)) + station_m * of_stations
    noise = replace(network, own_m=network.own_m * scale).noise
    fit = fit_least_squares(network.residual_function(observed_m), network.parameters(), noise)
    codes = (4 * network.first + network.second).astype(np.int32)
    paths = Labels.coded([f"{i}<x>{j}" for i in range(4) for j in range(4)], codes)
    assert (network.epoch != ALONE).all()
    return assessed(fit, labels(len(codes), "vlbi_delay"), paths, STEP_S * network.epoch.astype(float))


@pytest.mark.parametrize(("stated_m", "station_m"), [(0.4, 0.4), (0.01, 0.05)])
def test_stations_whose_errors_last_are_found_in_their_delays(stated_m, station_m):
    """Six baselines of four stations: three combinations hold the stations' errors, three only the baselines' own.

    Also where a small stated error of stations hardly tells the two kinds apart by their sigmas.
    """
    result = delays_with_lasting_errors(stated_m, station_m)
    assert len(result.series) == 3
    for item in result.series:
        assert item.name.endswith("of 6 that share errors")
        assert item.share > (0.8 if station_m == stated_m else 0.3)
        assert item.correlation_time_s == pytest.approx(TAU_S, rel=0.5)


def test_what_is_known_already_is_not_sought_again():
    """Residuals of correlated weights have been whitened by it."""
    fit, *data = line()
    correlation = assessed(fit, *data)
    refit = replace(line(coloured=0.0)[0], time_correlation=correlation)
    assert assessed(refit, *data) is correlation


def test_a_short_series_has_the_noise_of_its_kind():
    """Fifteen observations within a correlation time count as two, beside 1200 that count as eight."""
    fit, types, path, time_s = line()
    selected = (path.codes == 0) | (np.arange(len(time_s)) < 30)
    design, residual = fit.linearization.partials(np.flatnonzero(selected)), fit.residual_m[selected]
    reduced = fit_least_squares(lambda x: (residual - design @ x, design), fit.parameters, 1.0)
    result = assessed(reduced, types.select(selected), path.select(selected), time_s[selected])
    assert [item.name for item in result.series] == ["range S0", "range S1"]
    assert result.series[1].count == 15
    assert result.series[1].effective_count < 4.0
