"""Effects of gravity field errors on an orbit: the sigmas of its coefficients, and the degrees left out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from radioloc.dynamics.gravity import GravityField, acceleration_series, recursion
from radioloc.dynamics.orbit import Orbit
from radioloc.dynamics.perturbations import Perturbations
from radioloc.ephemeris import LunarOrientation
from radioloc.errors import InputError
from radioloc.lunar import rot_between, rot_icrf_to_pa
from radioloc.quantities import accepts_quantities
from radioloc.time import Epochs
from radioloc.vectors import Floats

_LAST_DEGREES = 20  # from which Kaula's rule, coefficients as 1/n^2, has its factor
_AT_ONCE = 256  # points whose harmonics are held together


def draw_gravity_errors(
    field: GravityField, count: int, degree: int, seed: int | np.random.Generator = 0
) -> list[GravityField]:
    """Errors that a gravity field may have, drawn by chance; the sum of their squares has its mean as covariance.

    Parameters
    ----------
    field : GravityField
        To its own degree the errors are of the coefficients' sigmas. Above it they are the coefficients themselves,
        which it leaves out: by Kaula's rule their sigma falls as 1/n^2, from what its last 20 degrees have.
    count : int
        How many draws; each is divided by the root of it.
    degree : int
        Highest degree of the errors. In an orbit at 50 km degree 220 has a tenth of the acceleration of 150.
    seed : int or Generator

    Returns
    -------
    list of GravityField
        Without the central term, with the GM, the radius and the axes of the field.

    Raises
    ------
    InputError
        The degree is lower than the field's, or there is no draw.

    Examples
    --------
    >>> from radioloc.dynamics import GravityField, draw_gravity_errors
    >>> draw_gravity_errors(GravityField.open("GRGM660PRIM", degree=50), count=20, degree=60)[-1]
    <GravityField error 20 of GRGM660PRIM to degree 60 in PA_DE421>
    """
    if count < 1 or degree < field.degree or field.degree < 2:
        raise InputError(
            f"count {count!r} and degree {degree!r} must be at least 1 and {field.degree}, the degree of {field.name}, "
            "and that at least 2"
        )
    random = np.random.default_rng(seed)
    n, m = np.meshgrid(np.arange(degree + 1.0), np.arange(degree + 1.0), indexing="ij")
    own = np.arange(max(2, field.degree - _LAST_DEGREES + 1), field.degree + 1)
    squares = (field.c[own] ** 2 + field.s[own] ** 2).sum(axis=1) / (2 * own + 1)
    factor = np.sqrt((squares * own**4.0).mean())
    omitted = np.where((n > field.degree) & (m <= n), factor / np.maximum(n, 1.0) ** 2, 0.0)
    room = ((0, degree - field.degree),) * 2
    sigmas = [omitted + np.pad(field.sigma_c, room), (omitted + np.pad(field.sigma_s, room)) * (m > 0)]
    draws = random.normal(size=(count, 2, degree + 1, degree + 1)) * np.stack(sigmas) / np.sqrt(count)
    return [
        replace(field, name=f"error {k} of {field.name}", c=c, s=s, sigma_c=sigmas[0], sigma_s=sigmas[1])
        for k, (c, s) in enumerate(draws, 1)
    ]


@accepts_quantities
def gravity_error_effects(
    orbit: Orbit, errors: list[GravityField], tdb: Epochs, *, libration: LunarOrientation | None = None
) -> Floats:
    """Compute changes of an orbit's states at epochs of TDB by gravity field errors, m and m/s, shape (n, 6, n_errors).

    Parameters
    ----------
    orbit : Orbit
        With partials by its state at the epoch, which the errors leave as it is.
    errors : list of GravityField
        Additions to the field, all to one degree (:func:`draw_gravity_errors`).
    tdb : Epochs
        Within the orbit.
    libration : LunarOrientation, optional
        DE421's by default.

    Raises
    ------
    InputError
        The orbit has no partials; there are no errors, or their degrees differ.
    CoverageError
        An epoch lies outside the orbit.

    Notes
    -----
    With the state transition matrix F from the epoch the change is F(t) times the integral of F(s)^-1 (0, a(s)) for the
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
        raise InputError("errors of one degree are needed, as draw_gravity_errors makes them")
    return errors_along(orbit, errors, libration or LunarOrientation.open()).at(tdb)


def errors_along(orbit: Orbit, errors: list[GravityField], libration: LunarOrientation) -> Perturbations:
    """Prepare :func:`gravity_error_effects` for any epochs of the orbit."""

    def pulls(moments: Epochs) -> Floats:
        rot = rot_between(libration.frame, errors[0].frame) @ rot_icrf_to_pa(libration.angles(moments)[0])
        points_m = np.ascontiguousarray(np.einsum("nij,nj->ni", rot, orbit.states(moments)[0]))
        return np.asarray(np.swapaxes(rot, 1, 2) @ _pulls(errors, points_m))

    return Perturbations(orbit, pulls)


def _pulls(errors: list[GravityField], points_m: Floats) -> Floats:
    """Accelerations by errors at points, m/s^2, axes of the field, shape (n, 3, n_errors); three digits suffice."""
    # The compiler takes a third of a second to import.
    from radioloc.dynamics._harmonic_kernels import harmonics_at

    field = errors[0]
    series = np.stack([acceleration_series(error.c - 1j * error.s) for error in errors], axis=-1)
    of_harmonics = series[:, *np.tril_indices(series.shape[1])]
    factors = np.concatenate([of_harmonics.real, -of_harmonics.imag], axis=1, dtype=np.float32)
    factors = np.swapaxes(factors, 0, 1).reshape(-1, 3 * len(errors))
    of_recursion = recursion(series.shape[1])
    harmonics = np.empty((_AT_ONCE, len(factors)), dtype=np.float32)
    sums = np.empty((len(points_m), 3 * len(errors)))
    for first in range(0, len(points_m), _AT_ONCE):
        some = points_m[first : first + _AT_ONCE]
        harmonics_at(some, field.radius_m, of_recursion, harmonics)
        sums[first : first + _AT_ONCE] = harmonics[: len(some)] @ factors
    return sums.reshape(-1, 3, len(errors)) * (field.gm_m3_s2 / field.radius_m**2)
