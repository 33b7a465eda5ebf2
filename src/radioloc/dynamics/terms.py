"""The accelerations of a spacecraft one by one."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radioloc.boundary import bare_arguments
from radioloc.constants import MEAN_LUNAR_RADIUS_M
from radioloc.dynamics._force_data import ACTS, PARTS
from radioloc.dynamics.forces import Forces
from radioloc.dynamics.propagation import force_data, initial_state
from radioloc.ephemeris import Ephemeris, LunarOrientation
from radioloc.errors import InputError
from radioloc.lunar import rot_icrf_to_pa
from radioloc.time import Epochs

_PLACES = 48


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
    # The compiler takes a third of a second to import.
    from radioloc.dynamics._force_kernels import accelerations, quantities

    data.given[:, ACTS] = 1.0
    parts = accelerations(state[:3], state[3:], quantities(0.0, data), data)
    return {name: scale * part for name, scale, part in zip(PARTS, data.scales, parts, strict=True)}


@bare_arguments
def acceleration_sizes(epoch: Epochs, height_m: float, forces: Forces) -> dict[str, float]:
    """Sizes of the accelerations in a circular orbit over the Moon's poles, by name, m/s^2: root mean square.

    The orbit passes over noon and midnight; the bodies stand where they are at the epoch (TDB), about DE421's Moon.

    Raises
    ------
    InputError
        A height above the sphere of 1737.4 km that is not positive.

    Examples
    --------
    >>> from radioloc.dynamics import Forces, GravityField, acceleration_sizes
    >>> from radioloc.time import epochs_from_strings
    >>> forces = Forces(GravityField.open("GRGM660PRIM", degree=20))
    >>> sizes = acceleration_sizes(epochs_from_strings("2012-04-09", "TDB"), 50e3, forces)
    >>> f"{sizes['tides']:.0e}"
    '5e-07'
    """
    if not height_m > 0.0:
        raise InputError(f"height_m = {height_m!r} is not above the sphere of the Moon; give a positive one")
    ephemeris = Ephemeris.open()
    pole = rot_icrf_to_pa(LunarOrientation.open().angles(epoch)[0])[0, 2]
    sun_m = ephemeris.geocentric("sun", epoch)[0][0] - ephemeris.geocentric("moon", epoch)[0][0]
    noon = sun_m - (sun_m @ pole) * pole
    noon /= np.linalg.norm(noon)
    radius_m = MEAN_LUNAR_RADIUS_M + height_m
    speed_m_s = np.sqrt(ephemeris.constants.gm_moon_m3_s2 / radius_m)
    squares = dict.fromkeys(PARTS, 0.0)
    for angle in 2.0 * np.pi * np.arange(_PLACES) / _PLACES:
        place_m = radius_m * (np.cos(angle) * noon + np.sin(angle) * pole)
        velocity_m_s = speed_m_s * (np.cos(angle) * pole - np.sin(angle) * noon)
        terms = acceleration_terms(epoch, place_m, velocity_m_s, forces, ephemeris=ephemeris)
        squares = {name: squares[name] + float(term @ term) for name, term in terms.items()}
    return {name: float(np.sqrt(square / _PLACES)) for name, square in squares.items()}
