"""Whole fits of published laser ranges: where the reflectors are, whatever the fit starts from."""

from dataclasses import replace

import numpy as np
import pytest
from paths import EXAMPLES
from quick import some

import radioloc
from radioloc import LunarPosition, Study
from radioloc.errors import CoverageError, InputError, StationError
from radioloc.estimation import time_correlation
from radioloc.measurements import FixedPoint
from radioloc.results.build import compare_with
from radioloc.study import EstimateChoice, ModelChoice

# JPL's positions in the principal axes of DE421, m: Williams, Boggs and Folkner, "DE421 Lunar Orbit, Physical
# Librations, and Surface Coordinates", JPL IOM 335-JW,DB,WF-20080314-001 (2008).
JPL_PA_M = {
    "apollo11": (1591967.522, 690698.105, 21003.310),
    "apollo14": (1652689.359, -520999.195, -109731.018),
    "apollo15": (1554678.949, 98094.118, 765004.906),
}
# What does not fit is looked for in test_consistency.py.
pytestmark = pytest.mark.usefixtures("unsearched")

SAME_M = 1e-4
"""Ways of saying the same thing differ by rounding and by where the iteration stops: 1e-3 sigmas of 0.07 m."""
START_M = 1e-3
"""From wherever it starts, a fit ends within a small part of its sigma."""


def fit(observations, target, *, model=None, consider_defaults=True, **estimate):
    study = Study(
        target=target,
        estimate=EstimateChoice(**estimate),
        model=model or ModelChoice(),
        consider_defaults=consider_defaults,
    )
    return radioloc.locate(study, observations)


def changed(observations, rows, by_m):
    value_m = observations.value_m.copy()
    value_m[rows] += by_m
    return replace(observations, value_m=value_m)


def apart_m(item, two):
    return float(np.linalg.norm(item.position_pa_m - two.position_pa_m))


@pytest.fixture(scope="module")
def solution(apollo15, near15):
    return fit(apollo15, near15)


@pytest.fixture(scope="module")
def unconsidered(apollo15, near15):
    """The solution without considered errors, which residuals and weights then do not have in them."""
    return fit(apollo15, near15, consider_defaults=False)


def test_apollo15_is_where_jpl_has_it(solution):
    assert solution.converged
    difference = compare_with(solution, np.array(JPL_PA_M["apollo15"]))
    assert difference.distance_m < 0.5
    assert difference.horizontal_m < 0.4
    assert 0.5 * solution.fit.total.rms_m < 0.05  # one way


@pytest.mark.parametrize("name", ["apollo11", "apollo14"])
def test_other_reflectors_are_where_jpl_has_them(name):
    near_m = np.array(JPL_PA_M[name]) + np.array([-1500.0, 2000.0, 1000.0])
    file = EXAMPLES / "reflectors/2006-2007" / f"{name}_apollo_2006-2007.csv"
    fitted = fit(radioloc.read_observations(file), LunarPosition.from_cartesian(near_m, "PA_DE421"))
    assert fitted.converged
    assert np.linalg.norm(fitted.position_pa_m - JPL_PA_M[name]) < 0.8


DIRECTIONS = np.array([(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0.3, 0.3, 0.9), (-1, 1, -1)])


@pytest.mark.parametrize("direction", some(range(6), [4]))
def test_any_start_within_50_km_gives_the_same_answer(direction, apollo15, solution):
    offset_m = 50e3 * DIRECTIONS[direction] / np.linalg.norm(DIRECTIONS[direction])
    start = LunarPosition.from_cartesian(np.array(JPL_PA_M["apollo15"]) + offset_m, "PA_DE421")
    fitted = fit(apollo15, start)
    assert fitted.converged
    assert apart_m(fitted, solution) < START_M


@pytest.mark.study
def test_tracking_with_outliers_starts_anywhere_on_the_near_side():
    """Residuals 2,000 km from the estimate do not decide which observations are outliers."""
    study = radioloc.read_study(EXAMPLES / "change5" / "change5.toml")
    distant = replace(study, target=LunarPosition.from_selenographic(10.0, 5.0, -1000.0))
    fitted, expected = radioloc.locate(distant), radioloc.locate(study)
    assert fitted.converged
    assert list(fitted.residuals.status) == list(expected.residuals.status)
    assert apart_m(fitted, expected) < START_M


@pytest.mark.parametrize("form", some(["geographic", "cartesian"], ["cartesian"]))
def test_frames_and_forms_agree(form, apollo15, near15, model, solution):
    for axes in ("PA", "ME"):
        fitted = fit(apollo15, near15.to_axes(axes, model.ephemeris.constants), position=form)
        assert apart_m(fitted, solution) < SAME_M
        assert fitted.sigma_enu_m() == pytest.approx(solution.sigma_enu_m(), rel=1e-3)


@pytest.mark.parametrize("blunder_m", some([19.0, -19.0, 2.0, 5e4], [2.0]))
def test_one_blunder_is_rejected_and_does_not_move_the_answer(blunder_m, apollo15, near15, solution):
    fitted = fit(changed(apollo15, [70], blunder_m), near15)
    assert fitted.converged
    assert fitted.residuals.status[70].startswith("outlier: ")
    assert fitted.fit.total.rejected == solution.fit.total.rejected + 1
    assert apart_m(fitted, solution) < 0.02
    assert fitted.residuals.residual_m[70] == pytest.approx(blunder_m, abs=0.3)


def test_order_of_the_input_is_kept(apollo15, near15, solution):
    order = np.random.default_rng(3).permutation(len(apollo15))
    fitted = fit(apollo15.select(order), near15)
    assert np.array_equal(fitted.residuals.observed_m, apollo15.value_m[order])
    assert apart_m(fitted, solution) < SAME_M


def test_residuals_fit_nothing(apollo15, near15):
    study = Study(target=LunarPosition.from_cartesian(JPL_PA_M["apollo15"], "PA_DE421"))
    fitted = radioloc.compute_residuals(study, apollo15)
    assert np.array_equal(fitted.position_pa_m, JPL_PA_M["apollo15"])
    assert fitted.fit.total.used == len(apollo15)
    assert set(fitted.fit.excess_noise_m.values()) <= {0.0}
    assert np.array_equal(fitted.residuals.sigma_m, apollo15.sigma_m)
    assert fitted.provenance["estimate"] is None
    assert "NO FIT" in str(fitted)
    assert 0.1 < fitted.fit.total.rms_m < 1.0  # 0.4 m off


@pytest.mark.study
def test_a_biased_station_is_found_out(apollo15, near15, solution):
    biased = changed(apollo15, slice(None), 0.8)
    free = fit(biased, near15, range_bias="all")
    named = fit(biased, near15, range_bias=["7045"])
    with_prior = fit(biased, near15, range_bias="all", range_bias_sigma_m=0.01)
    common = fit(apollo15, near15, range_bias="all")
    assert free.biases("range_bias")["APOLLO"][0] - common.biases("range_bias")["APOLLO"][0] == pytest.approx(
        0.8, abs=1e-3
    )
    assert apart_m(free, common) < START_M
    assert apart_m(free, named) < SAME_M
    # One station alone hardly tells its bias from the height: the prior decides.
    assert abs(with_prior.biases("range_bias")["APOLLO"][0]) < 0.05
    assert with_prior.biases("range_bias")["APOLLO"][1] < 0.0101
    assert free.sigma_enu_m()[2] > solution.sigma_enu_m()[2]


def test_height_prior_pulls_the_height(apollo15, near15, solution):
    height_m = solution.selenographic[2] + 5.0
    tight = fit(apollo15, near15, height_prior=radioloc.study.HeightPrior(height_m, 1e-3))
    loose = fit(apollo15, near15, height_prior=radioloc.study.HeightPrior(height_m, 1e3))
    assert tight.selenographic[2] == pytest.approx(height_m, abs=0.01)
    assert tight.sigma_enu_m()[2] == pytest.approx(1e-3, rel=0.01)
    assert apart_m(loose, solution) < START_M


@pytest.fixture(scope="module")
def thinned(apollo15, near15, model):
    """Some observations, their solution, and what each term adds to them."""
    sample = apollo15.select(slice(None, None, 12))
    full = fit(sample, near15)
    return (
        sample,
        full,
        radioloc.measurements.ExactPredictor(model, sample, FixedPoint(full.position_pa_m)).terms(),
    )


def test_model_of_the_caller_replaces_that_of_the_study(thinned, near15, model):
    sample, full, _ = thinned
    solution = radioloc.locate(Study(target=near15), sample, model=model.without("solid_earth_tide"))
    of_study = fit(sample, near15, model=ModelChoice(off=["solid_earth_tide"]))
    assert np.array_equal(solution.values, of_study.values)
    assert apart_m(solution, full) > 1e-3
    assert solution.provenance["terms_off"] == ["solid_earth_tide"]
    assert solution.provenance["study"] is None
    residuals = radioloc.compute_residuals(
        Study(target=near15), sample, model=model.without("solid_earth_tide")
    )
    assert residuals.provenance["terms_off"] == ["solid_earth_tide"]


def test_far_side_is_refused_in_words(apollo15):
    far_side = LunarPosition.from_selenographic(178.0, 26.0, 0.0)
    held = radioloc.study.EstimateChoice(position="none", range_bias="all")
    with pytest.raises(InputError, match=r"153.*rejected.*target's"):
        radioloc.locate(Study(target=far_side, estimate=held), apollo15)
    fitted = radioloc.compute_residuals(Study(target=far_side), apollo15)
    assert fitted.fit.total.used == 0
    assert fitted.fit.total.rejected == len(apollo15)


def test_position_of_another_ephemeris_is_refused(apollo15, near15):
    other_place = LunarPosition.from_cartesian(near15.xyz_m, "PA_DE430")
    with pytest.raises(InputError, match=r"^\[target\].*PA_DE421.*ME_DE421.*PA_DE430"):
        fit(apollo15, other_place)
    positions = radioloc.study.Reference(other_place, "other")
    for changes, table in (
        ({"reference": positions}, "reference"),
        ({"references": (positions,)}, "references"),
    ):
        with pytest.raises(InputError, match=rf"^\[{table}\] (other )?frame: "):
            radioloc.locate(Study(target=near15, **changes), apollo15)


def test_a_reference_of_another_ephemeris_is_turned_and_a_note_says_so(apollo15, near15):
    positions = [near15.to_frame(frame) for frame in ("PA_DE421", "PA_DE440")]
    fitted = [
        radioloc.compute_residuals(
            Study(target=near15, reference=radioloc.study.Reference(place, "known")), apollo15
        )
        for place in positions
    ]
    assert fitted[0].reference.distance_m == pytest.approx(fitted[1].reference.distance_m, abs=1e-6)


@pytest.mark.parametrize("kind", ["range_bias", "time_bias"])
def test_bias_of_a_station_without_observations_is_refused(kind, apollo15, near15):
    with pytest.raises(InputError, match=rf"\[estimate\] {kind}: .*APOLLO.*, got GRASSE"):
        fit(apollo15, near15, **{kind: ["GRASSE"]})
    with pytest.raises(StationError, match=rf"\[estimate\] {kind}: station 'NOPE'"):
        fit(apollo15, near15, **{kind: ["NOPE"]})


@pytest.mark.parametrize(("year", "source"), [(2035, "Earth orientation"), (2060, "de421_1969_2050.bsp")])
def test_epoch_that_is_not_covered_names_file_and_line(year, source, apollo15, near15):
    jd = apollo15.epoch.jd.copy()
    jd[33] = 2451544.5 + 365.25 * (year - 2000)
    jd[33] = np.floor(jd[33]) + 0.5
    late = replace(apollo15, epoch=radioloc.Epochs.from_jd(jd, apollo15.epoch.fraction, "UTC"))
    line = apollo15.line[33]
    with pytest.raises(
        CoverageError, match=rf"2006-2007.csv, line {line}: .*{source}.* got {year}"
    ) as caught:
        fit(late, near15)
    assert source in caught.value.source


def test_considered_errors_explain_what_lasts_in_the_residuals(solution, unconsidered):
    """Errors of the ephemeris are considered: without them the residuals stay correlated for days, with them not."""
    assert unconsidered.time_correlation.series
    assert solution.time_correlation is None
    assert solution.fit.excess_noise_m["range"] < 0.8 * unconsidered.fit.excess_noise_m["range"]
    assert np.linalg.norm(solution.sigma_enu_m("total")) > np.linalg.norm(unconsidered.sigma_enu_m("total"))


def test_weights_of_a_correlated_series(apollo15, near15, unconsidered, monkeypatch):
    monkeypatch.setattr(time_correlation, "DENSE", 0.0)
    fitted = fit(apollo15, near15, weights="correlated", consider_defaults=False)
    (weight,) = fitted.series_weights
    (item,) = fitted.time_correlation.series
    assert weight.name == item.name == "range APOLLO>apollo15>APOLLO"
    assert weight.weighed_as == pytest.approx(item.effective_count, rel=0.05)
    # Generalized least squares from the dense covariance: nothing is left to correct, and the sigmas are these.
    arc = radioloc.jobs.prepare_arc(Study(target=near15), apollo15)
    used, computed = fitted.residuals.used, arc.compute(FixedPoint(fitted.position_pa_m))
    residual_m, design = (apollo15.value_m - computed.value_m)[used], computed.by_position_pa[used]
    time_s = 86400.0 * (apollo15.epoch.jd - apollo15.epoch.jd[0] + apollo15.epoch.fraction)[used]
    stated = np.diag(fitted.residuals.sigma_m[used])
    lasting = np.exp(-np.abs(time_s[:, None] - time_s) / item.correlation_time_s)
    covariance = stated @ (np.eye(len(time_s)) + item.share / (1.0 - item.share) * lasting) @ stated
    inverse = np.linalg.inv(design.T @ np.linalg.solve(covariance, design))
    gain = np.linalg.solve(covariance, design @ inverse).T
    assert np.linalg.norm(gain @ residual_m) < SAME_M
    (noise,) = fitted.time_correlation.noise.values()
    processes = zip(noise.coloured, noise.tau_s, strict=True)
    errors = noise.white * np.eye(len(time_s)) + sum(
        c * np.exp(-np.abs(time_s[:, None] - time_s) / tau_s) for c, tau_s in processes
    )

    def sigma_enu_m(position):
        return np.sqrt(np.diag(fitted.rot_pa_to_enu @ position @ fitted.rot_pa_to_enu.T))

    assert fitted.sigma_enu_m("formal") == pytest.approx(sigma_enu_m(gain @ stated**2 @ gain.T), rel=1e-6)
    # Those of the card are the sandwich with the mean over the noise models that are as likely.
    sandwich = gain @ stated @ errors @ stated @ gain.T
    assert fitted.sigma_enu_m("scaled") == pytest.approx(sigma_enu_m(sandwich), rel=1e-3)
    # The best estimate is better known than another, and were errors as stated, it would be worse.
    assert (fitted.sigma_enu_m("scaled") < 0.95 * unconsidered.sigma_enu_m("scaled")).all()
    assert (fitted.sigma_enu_m("formal") > 1.05 * unconsidered.sigma_enu_m("formal")).all()
    assert apart_m(fitted, unconsidered) < 0.05
    np.testing.assert_allclose(fitted.residuals.sigma_m, unconsidered.residuals.sigma_m, rtol=0.0, atol=0.0)
    assert unconsidered.fit.chi2 <= fitted.fit.chi2 < 1.1 * unconsidered.fit.chi2


def test_model_errors_are_no_gross_errors():
    """Ten to twenty times the stated sigmas, of an ephemeris 16 years later: a start that holds them for errors would
    leave out 4 of 28 good ranges, of which each station has few."""
    study = radioloc.read_study("examples/apollo15/apollo15_2024.toml")
    fitted = radioloc.locate(replace(study, consider_defaults=False))
    assert fitted.fit.total.rejected == 0
    assert fitted.fit.excess_noise_m["range"] == pytest.approx(0.05, abs=0.01)
    considered = radioloc.locate(study)
    assert considered.fit.total.rejected == 0
    assert considered.fit.excess_noise_m["range"] < 0.03
