"""Effects of small perturbing accelerations on an orbit, to first order."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from radioloc.dynamics.orbit import Orbit
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
