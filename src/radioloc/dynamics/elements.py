"""Osculating elements of a state.

Angles are relative to reference axes, given as the rows of an array (3, 3), such as :func:`equatorial_axes`. Keplerian
elements are those of Montenbruck and Gill (2000), section 2.2. Equinoctial elements are regular for circular and
equatorial orbits (Walker, Ireland and Owens 1985, Celestial Mechanics 36, 409): the semi-major axis; ex and ey, the
eccentricity times cosine and sine of periapsis + node; hx and hy, tan(inclination / 2) times cosine and sine of the
node; and the true longitude, periapsis + node + true anomaly.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radioloc.ephemeris import LunarOrientation
from radioloc.errors import InputError
from radioloc.lunar import rot_icrf_to_pa
from radioloc.time import Epochs
from radioloc.vectors import Floats

KEPLERIAN = (
    "semi_major_axis_m",
    "eccentricity",
    "inclination_deg",
    "node_deg",
    "periapsis_deg",
    "true_anomaly_deg",
)
EQUINOCTIAL = ("semi_major_axis_m", "ex", "ey", "hx", "hy", "true_longitude_deg")
ELEMENT_NAMES = {"keplerian": KEPLERIAN, "equinoctial": EQUINOCTIAL}
"""Names of the elements of each form, in order."""

_IMAGINARY_STEP = 1e-30  # its square is negligible: complex steps give partials without cancellation errors
_RAD_PER_DEG = np.pi / 180.0  # np.radians refuses complex numbers


def equatorial_axes(orientation: LunarOrientation, tdb: Epochs) -> Floats:
    """Return axes of the Moon's equator at the first epoch, in the ICRF, as rows (3, 3).

    The x-axis points to the ascending node on the ICRF xy plane, the z-axis to the pole.
    """
    pole = rot_icrf_to_pa(orientation.angles(tdb)[0])[0, 2]
    to_node = np.array([-pole[1], pole[0], 0.0]) / np.hypot(pole[0], pole[1])
    return np.stack([to_node, np.cross(pole, to_node), pole])


def inclination_and_node_deg(state: Floats, axes: Floats) -> tuple[float, float]:
    """Return inclination and longitude of the ascending node (0 to 360) of a state in some axes, deg."""
    x, y, z = axes @ np.cross(state[:3], state[3:])  # angular momentum
    inclination_rad, node_rad = np.arctan2(np.hypot(x, y), z), np.arctan2(x, -y)
    return float(np.degrees(inclination_rad)), float(np.degrees(node_rad) % 360.0)


def elements_from_state(
    state: ArrayLike, gm_m3_s2: float, axes: ArrayLike, form: str = "keplerian"
) -> Floats:
    """Return the osculating elements of a state.

    Parameters
    ----------
    state : array_like, shape (6,)
        Position, m, and velocity, m/s, relative to the body's centre.
    gm_m3_s2 : float
        GM of the body, m^3/s^2.
    axes : array_like, shape (3, 3)
        Unit vectors of the reference axes as rows, in the frame of the state.
    form : {"keplerian", "equinoctial"}
        Kind of the elements.

    Returns
    -------
    ndarray, shape (6,)
        Elements in the order of :data:`KEPLERIAN` or :data:`EQUINOCTIAL`; node, periapsis, anomaly and longitude are 0
        to 360 deg. The semi-major axis of a hyperbola is negative.

    Raises
    ------
    InputError
        If position and velocity are parallel, the orbit is parabolic or has an inclination of exactly 180 deg, the
        state does not have six components, or the form is unknown.

    Examples
    --------
    >>> import numpy as np
    >>> from radioloc.dynamics import elements_from_state, state_from_elements
    >>> state = state_from_elements([1.8e6, 0.01, 88.0, 115.0, 30.0, 200.0], 4.9028e12, np.eye(3))
    >>> elements_from_state(state, 4.9028e12, np.eye(3)).round(6).tolist()
    [1800000.0, 0.01, 88.0, 115.0, 30.0, 200.0]
    """
    _require_form(form)
    if np.size(state) != 6:
        raise InputError(f"state: expected six numbers (position, velocity), got {np.size(state)}")
    position, velocity = (np.asarray(axes) @ vector for vector in np.reshape(state, (2, 3)))
    angular_momentum = np.cross(position, velocity)
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = np.linalg.norm(position)
        semi_major_axis_m = 1.0 / (2.0 / distance - velocity @ velocity / gm_m3_s2)
        normal_x, normal_y, normal_z = angular_momentum / np.linalg.norm(angular_momentum)
        # With an inclination of 180 deg the node is undefined.
        hx, hy = -normal_y / (1.0 + normal_z), normal_x / (1.0 + normal_z)
        axis_0, axis_90 = _orbital_axes(hx, hy)
        eccentricity_vector = np.cross(velocity, angular_momentum) / gm_m3_s2 - position / distance
    ex, ey = eccentricity_vector @ axis_0, eccentricity_vector @ axis_90
    true_longitude = np.arctan2(position @ axis_90, position @ axis_0)
    equinoctial = np.array([semi_major_axis_m, ex, ey, hx, hy, np.degrees(true_longitude) % 360.0])
    if not np.isfinite(equinoctial).all():
        raise InputError(
            "state: expected an elliptic or hyperbolic orbit with an inclination below 180 deg, got "
            f"{np.ravel(state).tolist()}"
        )
    if form == "equinoctial":
        return equinoctial
    node, periapsis_longitude = np.arctan2(hy, hx), np.arctan2(ey, ex)
    eccentricity, inclination = np.hypot(ex, ey), 2.0 * np.arctan(np.hypot(hx, hy))
    angles = [inclination, node, periapsis_longitude - node, true_longitude - periapsis_longitude]
    return np.array([semi_major_axis_m, eccentricity, *(np.degrees(angles) % 360.0)])


def state_from_elements(
    elements: ArrayLike, gm_m3_s2: float, axes: ArrayLike, form: str = "keplerian"
) -> Floats:
    """Return the state of osculating elements.

    Parameters
    ----------
    elements : array_like, shape (6,)
        Elements in the order of :data:`KEPLERIAN` or :data:`EQUINOCTIAL`, m and deg.
    gm_m3_s2 : float
        GM of the body, m^3/s^2.
    axes : array_like, shape (3, 3)
        Unit vectors of the reference axes as rows, in the frame of the state.
    form : {"keplerian", "equinoctial"}
        Kind of the elements.

    Returns
    -------
    ndarray, shape (6,)
        Position, m, and velocity, m/s, relative to the body's centre.

    Raises
    ------
    InputError
        The elements are not those of an ellipse with an inclination below 180 deg, or the form is unknown.

    Examples
    --------
    >>> import numpy as np
    >>> from radioloc.dynamics import state_from_elements
    >>> state_from_elements([2e6, 0.1, 90.0, 0.0, 0.0, 0.0], 4.9028e12, np.eye(3)).round(3).tolist()
    [1800000.0, 0.0, 0.0, 0.0, 0.0, 1730.941]
    """
    _require_form(form)
    values = np.asarray(elements, dtype=np.float64)
    if values.shape != (6,) or not np.isfinite(values).all():
        raise InputError(
            f"elements: expected six finite numbers ({', '.join(ELEMENT_NAMES[form])}), got {elements!r}"
        )
    semi_major_axis_m = values[0]
    eccentricity = values[1] if form == "keplerian" else np.hypot(values[1], values[2])
    if not (semi_major_axis_m > 0.0 and 0.0 <= eccentricity < 1.0):
        raise InputError(
            "elements: expected semi_major_axis_m above 0 and an eccentricity from 0 to less than 1, got "
            f"{semi_major_axis_m:g} and {eccentricity:g}; state a hyperbola by position_m and velocity_m_s"
        )
    if form == "keplerian" and not 0.0 <= values[2] < 180.0:
        raise InputError(f"inclination_deg: expected 0 to less than 180, got {values[2]:g}")
    return np.asarray(_analytic_state(values, gm_m3_s2, np.asarray(axes), form))


def state_with_partials(elements: Floats, gm_m3_s2: float, axes: Floats, form: str) -> tuple[Floats, Floats]:
    """Return the state (6,) and its partials (6, 6), per degree for angles; a hyperbola is allowed."""
    stepped = elements + 1j * _IMAGINARY_STEP * np.eye(6)
    states = np.stack([_analytic_state(item, gm_m3_s2, axes, form) for item in stepped], axis=-1)
    return states[:, 0].real, states.imag / _IMAGINARY_STEP


def _require_form(form: str) -> None:
    if form not in ELEMENT_NAMES:
        raise InputError(f"form: expected {' or '.join(ELEMENT_NAMES)}, got {form!r}")


def _analytic_state(elements: NDArray[Any], gm_m3_s2: float, axes: Floats, form: str) -> NDArray[Any]:
    """Compute the state as an analytic function, whose complex steps give its partials."""
    if form == "keplerian":
        semi_major_axis_m, eccentricity = elements[:2]
        inclination, node, periapsis, anomaly = elements[2:] * _RAD_PER_DEG
        ex, ey = eccentricity * np.cos(periapsis + node), eccentricity * np.sin(periapsis + node)
        tangent = np.tan(0.5 * inclination)
        hx, hy = tangent * np.cos(node), tangent * np.sin(node)
        true_longitude = periapsis + node + anomaly
    else:
        semi_major_axis_m, ex, ey, hx, hy, true_longitude_deg = elements
        true_longitude = true_longitude_deg * _RAD_PER_DEG
    cosine, sine = np.cos(true_longitude), np.sin(true_longitude)
    semi_latus_rectum = semi_major_axis_m * (1.0 - ex**2 - ey**2)
    distance = semi_latus_rectum / (1.0 + ex * cosine + ey * sine)
    if not (semi_latus_rectum.real > 0.0 and distance.real > 0.0):
        raise InputError(
            f"elements: expected an ellipse or a point of a hyperbola, got {elements.real.tolist()}"
        )
    speed_scale = np.sqrt(gm_m3_s2 / semi_latus_rectum)
    axis_0, axis_90 = _orbital_axes(hx, hy)
    position = distance * (cosine * axis_0 + sine * axis_90)
    velocity = speed_scale * ((cosine + ex) * axis_90 - (sine + ey) * axis_0)
    return np.concatenate([position @ axes, velocity @ axes])


def _orbital_axes(hx: Any, hy: Any) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return the directions of longitude 0 and 90 deg in the orbital plane."""
    norm = 1.0 + hx**2 + hy**2
    axis_0 = np.array([1.0 + hx**2 - hy**2, 2.0 * hx * hy, -2.0 * hy]) / norm
    axis_90 = np.array([2.0 * hx * hy, 1.0 - hx**2 + hy**2, 2.0 * hx]) / norm
    return axis_0, axis_90
