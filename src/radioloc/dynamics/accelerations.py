"""Accelerations of a spacecraft by term, and the data of their compiled code."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import ArrayLike, NDArray

from radioloc.constants import MEAN_LUNAR_RADIUS_M
from radioloc.dynamics import _force_data as layout
from radioloc.dynamics._force_data import ForceData
from radioloc.dynamics.forces import BODIES, Forces, single_tdb_epoch
from radioloc.dynamics.gravity import GravityField, acceleration_series, gradient_series, recursion, stacked
from radioloc.dynamics.orbit import STATE, initial_state
from radioloc.ephemeris import Ephemeris, LunarOrientation
from radioloc.errors import InputError
from radioloc.lunar import rot_between, rot_icrf_to_pa
from radioloc.quantities import EpochsLike, FloatLike, accepts_quantities
from radioloc.time import Epochs
from radioloc.vectors import Floats, rtn_axes

_SEGMENT_S = 21600.0
_NODE_COUNT = 12  # in 6 h the twelfth coefficient of the Moon's motion is below rounding
_MIN_SPEED_RATIO = 1e-30  # of velocity (m/s) and position (m): defines a plane for a state at rest on a pole
_SAMPLE_COUNT = 48  # positions along an orbit
_PERMANENT_TIDE_PA_S2 = np.array(
    [[6.978e-12, -2.2e-15, 2.8e-15], [-2.2e-15, 6.43e-14, 0.4e-15], [2.8e-15, 0.4e-15, 4.79e-14]]
)
"""Mean of the tide-raising tensor of Earth and Sun in principal axes, of DE421 over 18.6 years (the period of the lunar
node) in three starting years, which agree to 1e-4 of the largest element."""


@accepts_quantities
def acceleration_terms(
    epoch: EpochsLike,
    position_m: ArrayLike,
    velocity_m_s: ArrayLike,
    forces: Forces,
    *,
    ephemeris: Ephemeris | None = None,
    libration: LunarOrientation | None = None,
) -> dict[str, Floats]:
    """Return accelerations relative to the Moon's centre by name, ICRF axes, m/s^2, (3,); all empirical ones act."""
    ephemeris = ephemeris or Ephemeris.open()
    libration = libration or LunarOrientation.open(ephemeris.name)
    tdb = single_tdb_epoch("epoch", epoch)
    state = initial_state(position_m, velocity_m_s)
    data = force_data(forces, ephemeris, libration, tdb, (0.0, 0.0), state)
    # The compiler takes a third of a second to import.
    from radioloc.dynamics._force_kernels import accelerations, quantities

    data.empirical[:, layout.IS_ACTIVE] = 1.0
    parts = accelerations(state[:3], state[3:], quantities(0.0, data), data)
    return {name: scale * part for name, scale, part in zip(layout.PARTS, data.scales, parts, strict=True)}


@accepts_quantities
def acceleration_sizes(epoch: EpochsLike, height_m: FloatLike, forces: Forces) -> dict[str, float]:
    """Return root-mean-square accelerations in a circular orbit over the Moon's poles by name, m/s^2.

    The orbit passes over noon and midnight; the bodies remain at their positions at the epoch.

    Parameters
    ----------
    epoch : Epochs or Time
        Single epoch of any scale.
    height_m : float or Quantity
        Height above the sphere of 1737.4 km, m.
    forces : Forces

    Raises
    ------
    InputError
        The height is not positive.

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
        raise InputError(f"height_m: expected a height above 0, got {height_m!r}")
    ephemeris = Ephemeris.open()
    tdb = single_tdb_epoch("epoch", epoch)
    pole = rot_icrf_to_pa(LunarOrientation.open().angles(tdb)[0])[0, 2]
    sun_m = ephemeris.geocentric("sun", tdb)[0][0] - ephemeris.geocentric("moon", tdb)[0][0]
    noon = sun_m - (sun_m @ pole) * pole
    noon /= np.linalg.norm(noon)
    radius_m = MEAN_LUNAR_RADIUS_M + height_m
    speed_m_s = np.sqrt(ephemeris.constants.gm_moon_m3_s2 / radius_m)
    squares = dict.fromkeys(layout.PARTS, 0.0)
    for angle in 2.0 * np.pi * np.arange(_SAMPLE_COUNT) / _SAMPLE_COUNT:
        place_m = radius_m * (np.cos(angle) * noon + np.sin(angle) * pole)
        velocity_m_s = speed_m_s * (np.cos(angle) * pole - np.sin(angle) * noon)
        terms = acceleration_terms(tdb, place_m, velocity_m_s, forces, ephemeris=ephemeris)
        squares = {name: squares[name] + float(term @ term) for name, term in terms.items()}
    return {name: float(np.sqrt(square / _SAMPLE_COUNT)) for name, square in squares.items()}


def force_data(
    forces: Forces,
    ephemeris: Ephemeris,
    libration: LunarOrientation,
    epoch: Epochs,
    span_s: tuple[float, float],
    state: Floats,
    names: Sequence[str] = (),
) -> ForceData:
    """Prepare the data of compiled accelerations; empirical accelerations are inactive (column IS_ACTIVE)."""
    for body in forces.bodies:
        if body != "earth" and body not in ephemeris.bodies:
            raise InputError(
                f"bodies: {body} is missing in {ephemeris.name}; remove it from the bodies of Forces"
            )
    field = forces.gravity
    coefficients = field.c - 1j * field.s
    coefficients[0, 0] = 0.0  # the central term is separate
    series = stacked(acceleration_series(coefficients))
    part = slice(min(forces.gradient_degree, field.degree) + 1)
    table, first_s, length_s = body_table(ephemeris, libration, field.frame, epoch, span_s)
    masses = [ephemeris.constants.gm_m3_s2(body) for body in ("moon", *BODIES)]
    if forces.gm_m3_s2 is not None:
        masses[0] = forces.gm_m3_s2
    on, scales = np.ones(len(layout.PARTS), dtype=bool), np.ones(len(layout.PARTS))
    scales[layout.TIDES] = forces.k2
    scales[[layout.SUNLIGHT, layout.MOONLIGHT]] = forces.radiation_m2_kg
    for k, body in enumerate(BODIES):
        on[layout.EARTH + k] = body in forces.bodies
    on[layout.HARMONICS] = field.degree > 0
    on[layout.TIDES] = forces.k2 != 0.0 or "k2" in names
    on[layout.FIGURES], on[layout.RELATIVITY] = forces.figures, forces.relativity
    on[layout.SUNLIGHT] = forces.radiation_m2_kg != 0.0 or "radiation" in names
    on[layout.MOONLIGHT] = forces.moonlight and on[layout.SUNLIGHT]
    empirical = np.zeros((len(forces.accelerations), layout.FIRST_COMPONENT + layout.COMPONENT_COUNT))
    for row, item in zip(empirical, forces.accelerations, strict=True):
        row[layout.IS_RTN] = item.axes == "RTN"
        row[layout.PLANE_NORMAL : layout.FIRST_COMPONENT] = item.normal or 0.0
        row[layout.FIRST_COMPONENT :] = [*item.constant_m_s2, *item.cosine_m_s2, *item.sine_m_s2]
    return ForceData(
        table,
        first_s,
        length_s,
        np.array(masses),
        field.radius_m,
        series,
        stacked(gradient_series(coefficients[part, part])),
        recursion(len(series) + 1),
        on,
        scales,
        empirical,
        rtn_axes(state[:3], state[3:] + _MIN_SPEED_RATIO * np.roll(state[:3], 1))[:2],
        _permanent_tide(field),
    )


def _permanent_tide(field: GravityField) -> Floats:
    """Return the tide-raising tensor that the coefficients of a field include, axes of the field, 1/s^2, (3, 3)."""
    if field.tide_system != "zero_tide":
        return np.zeros((3, 3))
    rotation = rot_between("PA_DE421", field.frame)
    return np.ascontiguousarray(rotation @ _PERMANENT_TIDE_PA_S2 @ rotation.T)


def body_table(
    ephemeris: Ephemeris, libration: LunarOrientation, frame: str, epoch: Epochs, span_s: tuple[float, float]
) -> tuple[Floats, float, float]:
    """Return Chebyshev coefficients, (n_segments, QUANTITIES, n_coefficients), start and length of a segment, s."""
    # The quantities of `_force_data` in SI units; zeros for bodies that the ephemeris lacks.
    count = max(1, int(np.ceil((span_s[1] - span_s[0]) / _SEGMENT_S)))
    length_s = max(span_s[1] - span_s[0], 1.0) / count
    nodes = chebyshev.chebpts1(_NODE_COUNT)
    nodes_s = span_s[0] + length_s * (np.arange(count)[:, None] + 0.5 * (1.0 + nodes))
    tdb = epoch.shifted(nodes_s.ravel())
    values = np.zeros((nodes_s.size, layout.QUANTITIES))
    moon_m, moon_m_s = ephemeris.geocentric("moon", tdb)
    values[:, :3] = -moon_m
    for k, body in enumerate(BODIES[1:], 1):
        if body in ephemeris.bodies:
            values[:, 3 * k : 3 * k + 3] = ephemeris.geocentric(body, tdb)[0] - moon_m
    to_frame = rot_between(libration.frame, frame)
    rotation = to_frame @ rot_icrf_to_pa(libration.angles(tdb)[0])
    values[:, layout.ROTATION : layout.EARTH_VELOCITY] = rotation.reshape(-1, 9)
    values[:, layout.EARTH_VELOCITY : layout.SUN_VELOCITY] = -moon_m_s
    values[:, layout.SUN_VELOCITY : layout.MOON_VELOCITY] = ephemeris.geocentric("sun", tdb)[1] - moon_m_s
    values[:, layout.MOON_VELOCITY :] = ephemeris.earth(tdb).velocity_m_s + moon_m_s
    to_series = np.linalg.inv(chebyshev.chebvander(nodes, _NODE_COUNT - 1))
    table = np.einsum("kj,sjq->sqk", to_series, values.reshape(count, _NODE_COUNT, layout.QUANTITIES))
    return np.ascontiguousarray(table), span_s[0], length_s


def parameter_columns(forces: Forces, names: Sequence[str]) -> NDArray[np.int64]:
    """Return part and index of each parameter for the compiled :func:`variations`."""
    columns = {"gm": (layout.CENTRAL, 0), "k2": (layout.TIDES, 0), "radiation": (layout.SUNLIGHT, 0)}
    columns |= dict.fromkeys(STATE, (-1, 0))
    for row, acceleration in enumerate(forces.accelerations):
        first = row * layout.COMPONENT_COUNT
        names_of_row = enumerate(chain(*acceleration.names()))
        columns |= {name: (layout.EMPIRICAL, first + k) for k, name in names_of_row}
    for impulse in forces.impulses:
        columns |= dict.fromkeys(impulse.names(), (-1, 0))
    for name in names:
        if name not in columns:
            raise InputError(f"parameters of forces: expected {', '.join(columns)}, got {name!r}")
    return np.array([columns[name] for name in names], dtype=np.int64).reshape(-1, 2)
