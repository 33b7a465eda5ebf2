"""Effects of small perturbing accelerations on an orbit, to first order, and of errors of the gravity field.

Gravity errors are those of the coefficients, and omitted degrees.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from radioloc.dynamics.gravity import GravityField, acceleration_series, recursion
from radioloc.dynamics.orbit import Orbit
from radioloc.ephemeris import LunarOrientation
from radioloc.errors import InputError
from radioloc.lunar import rot_between, rot_icrf_to_pa
from radioloc.time import Epochs
from radioloc.vectors import Floats

_STEP_S = 10.0  # harmonics of degree 220 have a wavelength of 30 km, 18 s; steps have a node in their middle


class Perturbations:
    """Changes of an orbit by small accelerations, m/s^2, ICRF axes, (n, 3, c); its state at the epoch is unchanged."""

    # The equation is in `gravity_perturbations`; the orbit needs partials with respect to its state at the epoch.

    def __init__(self, orbit: Orbit, accelerations: Callable[[Epochs], Floats]) -> None:
        self.orbit = orbit
        first_s, last_s = orbit.flight_s
        # The epoch is an end of a step; Simpson's rule needs the middles of the steps.
        earlier_count, later_count = (int(np.ceil(span_s / _STEP_S)) for span_s in (-first_s, last_s))
        ends_s = np.union1d(
            np.linspace(first_s, 0.0, earlier_count + 1), np.linspace(0.0, last_s, later_count + 1)
        )
        grid_s = np.sort(np.concatenate([ends_s, 0.5 * (ends_s[1:] + ends_s[:-1])]))
        tdb = orbit.epoch.shifted(grid_s)
        perturbing = accelerations(tdb)
        transition = orbit.partials(tdb)[:, :, :6]
        rates = np.linalg.solve(transition, np.concatenate([np.zeros_like(perturbing), perturbing], axis=1))
        steps = np.diff(ends_s)[:, None, None] / 6.0 * (rates[:-2:2] + 4.0 * rates[1::2] + rates[2::2])
        total = np.concatenate([np.zeros((1, *steps.shape[1:])), np.cumsum(steps, axis=0)])
        self._ends_s, self._mapped = ends_s, total - total[np.searchsorted(ends_s, 0.0)]

    def mapped_to_epoch(self, tdb: Epochs) -> Floats:
        """Return changes at epochs of TDB, mapped to the orbit's epoch, m and m/s, shape (n, 6, c)."""
        times_s = tdb.seconds_since(self.orbit.epoch)
        columns = self._mapped.reshape(len(self._ends_s), -1).T
        at_times = np.stack([np.interp(times_s, self._ends_s, column) for column in columns], axis=-1)
        return at_times.reshape(len(times_s), *self._mapped.shape[1:])

    def state_changes(self, tdb: Epochs) -> Floats:
        """Return changes of the states at epochs of TDB, m and m/s, ICRF axes, shape (n, 6, c)."""
        return np.asarray(self.orbit.partials(tdb)[:, :, :6] @ self.mapped_to_epoch(tdb))


_KAULA_DEGREE_COUNT = 20  # highest degrees that determine the factor of Kaula's rule, sigma = factor / n^2
_BLOCK_SIZE = 256  # points whose harmonics are in memory together


def draw_gravity_errors(
    field: GravityField, count: int, degree: int, seed: int | np.random.Generator = 0
) -> list[GravityField]:
    """Draw errors of a gravity field up to a degree; the sum of their squares has the covariance as its mean.

    Up to the degree of the field the errors have the sigmas of the coefficients. Above it they are the omitted
    coefficients, with sigmas by Kaula's rule, proportional to 1/n^2, scaled by its last 20 degrees. At a height of
    50 km degree 220 has a tenth of the acceleration of degree 150.
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


def gravity_perturbations(
    orbit: Orbit, errors: list[GravityField], libration: LunarOrientation
) -> Perturbations:
    """Return the perturbations of an orbit with partials with respect to gravity field errors, all to one degree.

    With the state transition matrix F from the epoch, the change of the state is F(t) times the integral of
    F(s)^-1 (0, a(s)) for accelerations a by the error along the orbit (Montenbruck and Gill 2000, section 7.1).
    """

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
