"""Sources of the errors that laser ranges of one night have in common, by cross-validation over nights.

Random errors of each night, common to all reflectors, and of each range are estimated by restricted maximum
likelihood. Models are compared by the prediction of nights that the fit omits. The tables of
examples/reflectors/README.md are printed by

    PYTHONPATH=tests/support python tests/reference/test_reflector_nights.py
"""

import erfa
import numpy as np
import pytest
from paths import EXAMPLES
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize

import radioloc
from radioloc.jobs.preparation import prepared_arc
from radioloc.jobs.problem import EstimationProblem

FOLDS = 12


def other_causes(observations, station_partials):
    """Columns of the air (weather by station), of the year, and of Earth rotations that vary with it; sigmas, m."""
    year = (observations.epoch.mjd - 51544.5) / 365.25 * 2 * np.pi
    annual = np.array([wave(k * year) for k in (1, 2) for wave in (np.cos, np.sin)]).T
    names = np.array([link.receiver for link in observations.links])[observations.link]
    weather = []
    for name in np.unique(names):
        rows = names == name
        for values in (observations.pressure_hpa, observations.temperature_k):
            weather.append(np.where(rows, (values - values[rows].mean()) / 10.0, 0.0))  # hPa, K
    gradient = station_partials.reshape(len(names), -1, 3).sum(axis=1)  # by the station of each range
    catalogue = radioloc.StationCatalogue.default()
    places = np.array(
        [catalogue.get(name).itrf_m / np.linalg.norm(catalogue.get(name).itrf_m) for name in names]
    )
    rotations = np.cross(places, gradient)
    earth = (rotations[:, :, None] * annual[:, None, :]).reshape(len(names), -1)
    return {"air": (np.array(weather).T, 0.03), "annual": (annual, 0.05), "earth": (earth, 0.05)}


class Nights:
    """Ranges of the four reflectors, one way, with models as blocks of columns and their a-priori sigmas."""

    def __init__(self, ephemeris):
        study = radioloc.read_study(EXAMPLES / f"reflectors/{ephemeris}.toml")
        arc, _ = prepared_arc(study, None)
        problem = EstimationProblem.from_study(study, arc, study.estimate)
        design = problem.model.linearize(problem.model.parameters.prior_values)
        partials = 0.5 * design.partials(np.arange(len(design.residual_m)))
        kinds = np.array([item.kind for item in problem.model.parameters])
        columns = {kind: partials[:, kinds == kind] for kind in set(kinds)}
        self.residual_m, self.sigma_m = 0.5 * design.residual_m, 0.5 * problem.noise.sigma_m
        self.night = (columns["moon_position_variation"][:, 0::3] != 0.0).argmax(axis=1)
        centuries = (arc.observations.epoch.mjd - 51544.5) / 36525.0
        anomaly, elongation, latitude = (f(centuries) for f in (erfa.fal03, erfa.fad03, erfa.faf03))
        months = (anomaly, elongation, 2 * elongation - anomaly, 2 * elongation, latitude)
        waves = [wave(angle)[:, None] for angle in months for wave in (np.cos, np.sin)]
        self.blocks = {
            "basis": (
                np.hstack([columns["position"], columns["station_position"], columns["range_bias"]]),
                1.0,
            ),
            "libration": (columns["longitude_libration"], 1e-7),
            "orbit": (columns["moon_position"][:, :1] * np.hstack(waves), 0.05),
        }
        self.blocks |= other_causes(arc.observations, columns["station_position"])
        self.rows = np.arange(len(self.residual_m))
        for _ in range(3):  # outliers of the complete model
            residual_m = self.fit(self.rows, ("libration", "orbit"))[2]
            self.rows = self.rows[np.abs(residual_m) < 7.4 * np.median(np.abs(residual_m))]

    def estimate(self, rows, names, noise_m):
        """Parameters, twice the restricted log likelihood with its sign reversed, and residuals."""
        blocks = [self.blocks[name] for name in ("basis", *names)]
        design = np.hstack([block for block, _ in blocks])
        prior = np.concatenate([np.full(block.shape[1], sigma) for block, sigma in blocks])
        prior[12:21], prior[21:24] = 0.03, 0.01  # station coordinates, range biases
        scaled, residual_m = design[rows] * prior, self.residual_m[rows]
        common = self.night[rows, None] == self.night[rows]
        factor = cho_factor(
            np.diag(self.sigma_m[rows] ** 2 + noise_m[0] ** 2) + noise_m[1] ** 2 * common, lower=True
        )
        normal = scaled.T @ cho_solve(factor, scaled) + np.eye(len(prior))
        x = np.linalg.solve(normal, scaled.T @ cho_solve(factor, residual_m))
        left_m = residual_m - scaled @ x
        likelihood = 2 * np.log(np.diag(factor[0])).sum() + np.linalg.slogdet(normal)[1]
        return prior * x, likelihood + left_m @ cho_solve(factor, left_m) + x @ x, left_m, design

    def fit(self, rows, names):
        """Noise of ranges and of nights, m, likelihood and residuals."""

        def objective(log_noise):
            return self.estimate(rows, names, np.exp(log_noise))[1]

        best = minimize(objective, np.log([0.01, 0.02]), method="Nelder-Mead", bounds=[(-9.0, -2.0)] * 2)
        return np.exp(best.x), best.fun, self.estimate(rows, names, np.exp(best.x))[2]

    def predicted_rms_m(self, names):
        """Rms error of ranges predicted from the other nights."""
        noise_m = self.fit(self.rows, names)[0]
        fold = np.random.default_rng(1).permutation(self.night.max() + 1) % FOLDS
        errors_m = []
        for k in range(FOLDS):
            omitted = fold[self.night[self.rows]] == k
            x, _, _, design = self.estimate(self.rows[~omitted], names, noise_m)
            errors_m.append(self.residual_m[self.rows[omitted]] - design[self.rows[omitted]] @ x)
        return np.sqrt(np.mean(np.concatenate(errors_m) ** 2))


@pytest.fixture(scope="module")
def older():
    return Nights("de421")


@pytest.fixture(scope="module")
def newer():
    return Nights("de440")


@pytest.mark.slow
def test_periodic_libration_of_de440_explains_the_scatter_between_reflectors(newer):
    (scatter_m, _), likelihood, _ = newer.fit(newer.rows, ())
    (reduced_m, _), reduced, _ = newer.fit(newer.rows, ("libration",))
    assert scatter_m > 0.01
    assert reduced_m < 0.003
    assert likelihood - reduced > 80.0  # chi-square of six terms: 22 in 1 of 1000 cases
    assert newer.predicted_rms_m(("libration",)) < 0.94 * newer.predicted_rms_m(())


@pytest.mark.slow
def test_monthly_orbit_terms_reduce_the_common_error_of_a_night(older, newer):
    rms_m = {}
    for name, nights in (("de421", older), ("de440", newer)):
        night_m = nights.fit(nights.rows, ("libration",))[0][1]
        assert nights.fit(nights.rows, ("libration", "orbit"))[0][1] < 0.8 * night_m
        rms_m[name] = [nights.predicted_rms_m(names) for names in (("libration",), ("libration", "orbit"))]
        assert rms_m[name][1] < 0.93 * rms_m[name][0]
    # An ephemeris with thirteen years of data more predicts better, which no error of stations explains.
    assert rms_m["de440"][0] < 0.85 * rms_m["de421"][0]


@pytest.mark.slow
def test_other_causes_than_the_orbit_do_not_predict_other_nights(newer):
    for base in (("libration",), ("libration", "orbit")):
        rms_m = newer.predicted_rms_m(base)
        assert all(
            newer.predicted_rms_m((*base, cause)) > 0.98 * rms_m for cause in ("air", "annual", "earth")
        )


@pytest.mark.slow
def test_rms_of_all_residuals_with_orbit_terms_is_16_mm(newer):
    residual_m = newer.fit(newer.rows, ("libration", "orbit"))[2]
    assert len(newer.rows) > 0.93 * len(newer.residual_m)
    assert np.sqrt(np.mean(residual_m**2)) == pytest.approx(0.0159, abs=3e-4)


def print_tables():
    libration, orbit = ("libration",), ("libration", "orbit")
    extended = [(*base, cause) for base in (libration, orbit) for cause in ("air", "annual", "earth")]
    print("ephemeris; range, night, residuals, predicted, mm; ranges; model")
    for ephemeris in ("de421", "de440"):
        nights = Nights(ephemeris)
        for names in ((), libration, orbit, *extended):
            noise_m, _, residual_m = nights.fit(nights.rows, names)
            rms_m = (*noise_m, np.sqrt(np.mean(residual_m**2)), nights.predicted_rms_m(names))
            print(ephemeris, *(f"{1e3 * value:6.1f}" for value in rms_m), len(nights.rows), ", ".join(names))


if __name__ == "__main__":
    print_tables()
