"""Find the cause of errors that the ranges of a night have in common, by prediction of data that are left out.

    python examples/reflectors/nights.py

Night means of the residuals scatter more than ranges within a night. The candidates are an error common to all
reflectors of a night (distance of the Moon, station, air) and an error of the libration, which differs between
reflectors. Each model is a Gaussian prior for the errors of a night, with the sigma of the largest predictive
likelihood. Two tests leave data out: all ranges of one reflector in a night, predicted from the others of that
night; and all ranges of a night, predicted from the other nights with terms of monthly and annual periods.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

import radioloc
from radioloc.measurements import ExactPredictor, FixedPoint, PhysicalModel

HERE = Path(__file__).resolve().parent
SCATTER_M = 0.014  # round trip, of ranges within a night beyond their sigmas
PRIOR_M = 100.0  # of coordinates, rad for angles below
RADIUS_M = 1737400.0
# Periods, d: anomalistic, draconic and synodic month, evection, half month, year.
PERIODS_DAY = (27.55455, 27.21222, 29.53059, 31.81194, 14.76529, 365.25964)
# Arguments l', 2l - 2D and 2F - 2l of the libration in longitude.
LIBRATION_PERIODS_DAY = (365.25964, 205.89, 1095.18)
SIGMAS_M = (0.005, 0.01, 0.02, 0.03, 0.05, 0.08)


def ranges(ephemeris):
    """Return residuals to the a-priori positions, partials by position, reflector, night and epoch of all ranges."""
    study = radioloc.read_study(HERE / f"{ephemeris.lower()}.toml")
    model = PhysicalModel.build(ephemeris=ephemeris, libration=ephemeris)
    parts = []
    for number, (name, target) in enumerate(study.targets.items()):
        data = radioloc.read_observations([file for file in study.observations.files if name in file.name])
        place_m = target.xyz_m
        values = [
            ExactPredictor(model, data, FixedPoint(place_m + step)).compute().value_m
            for step in np.vstack([np.zeros(3), 100.0 * np.eye(3)])
        ]
        partials = np.stack([(value - values[0]) / 100.0 for value in values[1:]], axis=-1)
        days = data.epoch.mjd
        parts.append((data.value_m - values[0], partials, np.full(len(days), number), days, data.sigma_m,
                      np.tile(place_m, (len(days), 1))))  # fmt: skip
    return [np.concatenate(column) for column in zip(*parts, strict=True)]


def design_of(partials, reflector, places_m, nights):
    """Return design matrices: coordinates of reflectors; of each night, a common range and three rotations, m."""
    count = reflector.max() + 1
    coordinates = (partials[:, None, :] * np.eye(count)[reflector][:, :, None]).reshape(len(partials), -1)
    rotations = np.cross(places_m, partials) / RADIUS_M
    is_night = np.eye(nights.max() + 1)[nights]
    turned = (rotations[:, None, :] * is_night[:, :, None]).reshape(len(partials), -1)
    return coordinates, 2.0 * is_night, turned


def covariance_of(sigma_m, columns):
    """Return the covariance of the ranges: noise, and Gaussian priors of columns with their sigmas."""
    return np.diag(sigma_m**2 + SCATTER_M**2) + sum(s**2 * a @ a.T for a, s in columns)


def predict(residuals_m, covariance_m2, groups):
    """Return errors of groups predicted from the data of other groups, and the log likelihood."""
    weights = np.linalg.inv(covariance_m2)
    weighted_m = weights @ residuals_m
    errors, likelihood = [], 0.0
    for rows in groups:
        block = weights[np.ix_(rows, rows)]  # inverse of the covariance of the prediction errors
        error_m = np.linalg.solve(block, weighted_m[rows])
        errors.append(error_m.mean())
        likelihood += 0.5 * np.linalg.slogdet(block)[1] - 0.5 * error_m @ block @ error_m
    return np.array(errors), likelihood


def main():
    for ephemeris in ("DE421", "DE440"):
        residuals_m, partials, reflector, days, sigma_m, places_m = ranges(ephemeris)
        _, nights = np.unique(np.round(days), return_inverse=True)
        coordinates, common, turned = design_of(partials, reflector, places_m, nights)
        base = [(coordinates, PRIOR_M)]
        phases = 2.0 * np.pi * days[:, None] / np.array(PERIODS_DAY)
        periodic = 2.0 * np.hstack([np.cos(phases), np.sin(phases)])
        keys = nights * 10 + reflector
        several = [n for n in np.unique(nights) if len(np.unique(reflector[nights == n])) > 1]
        pairs = [np.flatnonzero(keys == key) for key in np.unique(keys) if key // 10 in several]
        print(
            f"{ephemeris}: {len(days)} ranges, {nights.max() + 1} nights, {len(several)} with several reflectors"
        )
        print("  a reflector of a night from the other reflectors of it; means, one way")
        for name, varied in {
            "no errors of nights": [],
            "common range": [common],
            "libration": [turned],
            "both": [common, turned],
        }.items():
            report(name, residuals_m, sigma_m, base, varied, pairs)
        print("  a night from other nights")
        groups = [np.flatnonzero(nights == n) for n in np.unique(nights)]
        random = [*base, (common, 0.02), (turned, 0.02)]
        about_z = np.cross(places_m, partials)[:, 2:] / RADIUS_M
        phases = 2.0 * np.pi * days[:, None] / np.array(LIBRATION_PERIODS_DAY)
        librations = about_z * np.hstack([np.cos(phases), np.sin(phases)])
        for name, varied in {
            "no periodic terms": [],
            "periodic ranges": [periodic],
            "longitude librations": [librations],
        }.items():
            report(name, residuals_m, sigma_m, random, varied, groups)


def report(name, residuals_m, sigma_m, fixed, varied, groups):
    """Print the error of prediction for the sigma of the largest likelihood."""
    results = []
    for size_m in SIGMAS_M:
        columns = [*fixed, *((column, size_m) for column in varied)]
        covariance_m2 = covariance_of(sigma_m, columns)
        errors_m, likelihood = predict(residuals_m, covariance_m2, groups)
        results.append(
            (
                likelihood,
                size_m,
                500.0 * 1.4826 * np.median(np.abs(errors_m)),
                500.0 * np.sqrt(np.mean(errors_m**2)),
            )
        )
    likelihood, size_m, error_mm, rms_mm = max(results)
    text = f"sigma {1e3 * size_m:3.0f} mm  error {error_mm:5.1f} mm, rms {rms_mm:5.1f} mm"
    print(f"    {name:22} {text}  log likelihood {likelihood:8.1f}")


if __name__ == "__main__":
    main()
