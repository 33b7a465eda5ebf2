"""The accelerations of a spacecraft one by one."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radioloc.boundary import bare_arguments
from radioloc.dynamics._force_kernels import ACTS, PARTS, accelerations, quantities
from radioloc.dynamics.forces import Forces
from radioloc.dynamics.propagation import force_data, initial_state
from radioloc.ephemeris import Ephemeris, LunarOrientation
from radioloc.time import Epochs


@bare_arguments
def acceleration_terms(
    epoch: Epochs,
    position_m: ArrayLike,
    velocity_m_s: ArrayLike,
    forces: Forces,
    *,
    ephemeris: Ephemeris | None = None,
    libration: LunarOrientation | None = None,
) -> dict[str, NDArray[np.float64]]:
    """Accelerations of a spacecraft relative to the Moon's centre, by name, ICRF axes, m/s^2, shape (3,) each.

    Parameters
    ----------
    epoch : Epochs
        TDB, one.
    position_m, velocity_m_s : array_like, shape (3,)
        State relative to the Moon's centre, ICRF axes.
    forces : Forces
        All of its given accelerations are taken to act.
    ephemeris, libration : optional
        As in :func:`propagate`.

    Raises
    ------
    InputError, CoverageError
        As :func:`propagate`.

    Examples
    --------
    >>> from radioloc.dynamics import Forces, GravityField, acceleration_terms
    >>> from radioloc.time import epochs_from_strings
    >>> epoch = epochs_from_strings("2012-04-09T04:30:00", "TDB")
    >>> forces = Forces(GravityField.open("GRGM660PRIM", degree=20))
    >>> terms = acceleration_terms(epoch, [0.0, 0.0, 1.788e6], [1656.0, 0.0, 0.0], forces)
    >>> {name: f"{(term**2).sum() ** 0.5:.1e}" for name, term in terms.items() if name in ("central", "earth")}
    {'central': '1.5e+00', 'earth': '1.8e-05'}
    """
    ephemeris = ephemeris or Ephemeris.open()
    libration = libration or LunarOrientation.open(ephemeris.name)
    state = initial_state(position_m, velocity_m_s)
    data = force_data(forces, ephemeris, libration, epoch, (0.0, 0.0), state)
    data.given[:, ACTS] = 1.0
    parts = accelerations(state[:3], state[3:], quantities(0.0, data), data)
    return {name: scale * part for name, scale, part in zip(PARTS, data.scales, parts, strict=True)}
