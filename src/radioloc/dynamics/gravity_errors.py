"""Effects of gravity field errors on an orbit: errors of the coefficients, and omitted degrees."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from radioloc.dynamics.gravity import GravityField, acceleration_series, recursion
from radioloc.dynamics.orbit import Orbit
from radioloc.dynamics.perturbations import Perturbations
from radioloc.ephemeris import LunarOrientation
from radioloc.errors import InputError
from radioloc.lunar import rot_between, rot_icrf_to_pa
from radioloc.quantities import EpochsLike, accepts_quantities
from radioloc.time import Epochs
from radioloc.vectors import Floats

_KAULA_DEGREE_COUNT = 20  # highest degrees that determine the factor of Kaula's rule, sigma = factor / n^2
_BLOCK_SIZE = 256  # points whose harmonics are in memory together


def draw_gravity_errors(
    field: GravityField, count: int, degree: int, seed: int | np.random.Generator = 0
) -> list[GravityField]:
    """Draw errors of a gravity field; the sum of their squares has the covariance as its mean.

    Parameters
    ----------
    field : GravityField
        Up to its degree the errors have the sigmas of the coefficients. Above it they are the omitted coefficients,
        with sigmas by Kaula's rule, proportional to 1/n^2, scaled by its last 20 degrees.
    count : int
        Number of draws; each is divided by its square root.
    degree : int
        Highest degree of the errors. At a height of 50 km degree 220 has a tenth of the acceleration of degree 150.
    seed : int or Generator
        Seed of the random numbers.

    Returns
    -------
    list of GravityField
        Errors with the GM, radius and axes of the field, without a central term.

    Raises
    ------
    InputError
        The degree is lower than that of the field, or the count is below 1.

    Examples
    --------
    >>> from radioloc.dynamics import GravityField, draw_gravity_errors
    >>> draw_gravity_errors(GravityField.open("GRGM660PRIM", degree=50), count=20, degree=60)[-1]
    <GravityField error 20 of GRGM660PRIM to degree 60 in PA_DE421>
    """
    if count < 1 or degree < field.degree or field.degree < 2:
        raise InputError(
            f"expected a count of at least 1 and a degree of at least {max(2, field.degree)}, got {count!r}, {degree!r}"
        )
    random = np.random.default_rng(seed)
    n, m = np.meshgrid(np.arange(degree + 1.0), np.arange(degree + 1.0), indexing="ij")
    last = np.arange(max(2, field.degree - _KAULA_DEGREE_COUNT + 1), field.degree + 1)
    squares = (field.c[last] ** 2 + field.s[last] ** 2).sum(axis=1) / (2 * last + 1)
    factor = np.sqrt((squares * last**4.0).mean())
    omitted = np.where((n > field.degree) & (m <= n), factor / np.maximum(n, 1.0) ** 2, 0.0)
    padding = ((0, degree - field.degree),) * 2
    sigmas = [omitted + np.pad(field.sigma_c, padding), (omitted + np.pad(field.sigma_s, padding)) * (m > 0)]
    draws = random.normal(size=(count, 2, degree + 1, degree + 1)) * np.stack(sigmas) / np.sqrt(count)
    return [
        replace(field, name=f"error {k} of {field.name}", c=c, s=s, sigma_c=sigmas[0], sigma_s=sigmas[1])
        for k, (c, s) in enumerate(draws, 1)
    ]


@accepts_quantities
def gravity_error_effects(
    orbit: Orbit, errors: list[GravityField], tdb: EpochsLike, *, libration: LunarOrientation | None = None
) -> Floats:
    """Compute changes of an orbit's states at epochs of TDB by gravity field errors, m and m/s, shape (n, 6, n_errors).

    Parameters
    ----------
    orbit : Orbit
        Orbit with partials by its state at the epoch, which the errors do not change.
    errors : list of GravityField
        Additions to the field, all to the same degree (:func:`draw_gravity_errors`).
    tdb : Epochs
        Epochs within the orbit.
    libration : LunarOrientation, optional
        Orientation of the Moon; DE421 by default.

    Raises
    ------
    InputError
        The orbit lacks partials, or the list of errors is empty or has several degrees.
    CoverageError
        An epoch is outside of the orbit.

    Notes
    -----
    With the state transition matrix F from the epoch, the change is F(t) times the integral of F(s)^-1 (0, a(s)) for
    accelerations a by the error along the orbit (Montenbruck and Gill 2000, section 7.1), by Simpson's rule.

    Examples
    --------
    >>> from radioloc.dynamics import Forces, GravityField, draw_gravity_errors, gravity_error_effects, propagate
    >>> from radioloc.time import epochs_from_strings
    >>> epoch, field = epochs_from_strings("2012-04-09T04:30:00", "TDB"), GravityField.open("GRGM660PRIM", degree=60)
    >>> state = [575750.0, -463261.0, -1631634.0], [-567.855, 1434.222, -600.22]
    >>> orbit = propagate(epoch, *state, Forces(field), (0, 7200), parameters=())
    >>> effects = gravity_error_effects(orbit, draw_gravity_errors(field, 4, 80), epoch.shifted(7200.0))
    >>> effects.shape
    (1, 6, 4)
    """
    if len({error.degree for error in errors}) != 1:
        raise InputError("errors: expected fields of the same degree, as from draw_gravity_errors")
    return gravity_perturbations(orbit, errors, libration or LunarOrientation.open()).state_changes(tdb)


def gravity_perturbations(
    orbit: Orbit, errors: list[GravityField], libration: LunarOrientation
) -> Perturbations:
    """Return the perturbations of an orbit by gravity field errors."""

    def accelerations(tdb: Epochs) -> Floats:
        rot = rot_between(libration.frame, errors[0].frame) @ rot_icrf_to_pa(libration.angles(tdb)[0])
        points_m = np.ascontiguousarray(np.einsum("nij,nj->ni", rot, orbit.states(tdb)[0]))
        return np.asarray(np.swapaxes(rot, 1, 2) @ _accelerations(errors, points_m))

    return Perturbations(orbit, accelerations)


def _accelerations(errors: list[GravityField], points_m: Floats) -> Floats:
    """Return accelerations by errors at points, m/s^2, axes of the field, (n, 3, n_errors), to three digits."""
    # The compiler takes a third of a second to import.
    from radioloc.dynamics._harmonic_kernels import harmonics_at

    field = errors[0]
    series = np.stack([acceleration_series(error.c - 1j * error.s) for error in errors], axis=-1)
    of_harmonics = series[:, *np.tril_indices(series.shape[1])]
    factors = np.concatenate([of_harmonics.real, -of_harmonics.imag], axis=1, dtype=np.float32)
    factors = np.swapaxes(factors, 0, 1).reshape(-1, 3 * len(errors))
    of_recursion = recursion(series.shape[1])
    harmonics = np.empty((_BLOCK_SIZE, len(factors)), dtype=np.float32)
    sums = np.empty((len(points_m), 3 * len(errors)))
    for first in range(0, len(points_m), _BLOCK_SIZE):
        block = points_m[first : first + _BLOCK_SIZE]
        harmonics_at(block, field.radius_m, of_recursion, harmonics)
        sums[first : first + _BLOCK_SIZE] = harmonics[: len(block)] @ factors
    return sums.reshape(-1, 3, len(errors)) * (field.gm_m3_s2 / field.radius_m**2)
