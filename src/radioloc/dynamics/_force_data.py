"""Data of compiled forces and of the compiled integration; importing this module does not import the compiler."""

from typing import NamedTuple

from radioloc.vectors import Floats, Mask

PARTS = (
    *("central", "harmonics", "tides", "earth", "sun", "venus", "jupiter", "saturn"),
    *("figures", "relativity", "sunlight", "moonlight", "empirical"),
)
"""Accelerations in the order of :func:`accelerations`; empirical ones include finite manoeuvres."""
CENTRAL, HARMONICS, TIDES, EARTH, SUN = range(5)
FIGURES, RELATIVITY, SUNLIGHT, MOONLIGHT, EMPIRICAL = range(8, 13)

# Quantities of the table of bodies: positions of Earth to Saturn, the rotation to the field's axes row by row,
# velocities of the Earth, the Sun and, seen from the barycentre, the Moon.
ROTATION, EARTH_VELOCITY, SUN_VELOCITY, MOON_VELOCITY, QUANTITIES = 15, 24, 27, 30, 33

IS_ACTIVE, IS_RTN, PLANE_NORMAL, FIRST_COMPONENT = 0, 1, 2, 5
"""Columns of an empirical acceleration: 1 if active, 1 for radial, transverse and normal axes, the normal of a fixed
plane of these axes (zeros: the orbital plane), components."""
COMPONENT_COUNT = 9
"""Number of components: constant, cosine and sine along three axes."""


class ForceData(NamedTuple):
    """Data on which the accelerations depend."""

    table: Floats  # Chebyshev series of the quantities, shape (n_segments, QUANTITIES, n_coefficients)
    start_s: float  # of the first segment
    length_s: float  # of each segment
    gm: Floats  # Moon, Earth, Sun, Venus, Jupiter, Saturn
    radius_m: float  # of the harmonics
    series: Floats
    gradient_series: Floats
    recursion: Floats
    on: Mask  # mask of the computed PARTS
    scales: Floats  # factors of PARTS: 1, or k2 and the radiation coefficient
    empirical: Floats  # shape (n, FIRST_COMPONENT + COMPONENT_COUNT)
    phase: Floats  # directions of phase zero and 90 deg of periodic accelerations, shape (2, 3)
    # Tide-raising tensor that the field's coefficients include, its axes, 1/s^2, shape (3, 3).
    permanent: Floats


DONE, STUCK, IN_MOON, IN_EARTH, TOO_MANY = range(5)
"""Outcomes of an integration: at its end, steps too small, in the Moon, in the Earth, too many steps."""

MIN_STEP_S = 1e-6
NODES = 16
"""Number of nodes of a step; in a low orbit 12 cost a quarter more, and 20 save no time."""


class Collocation(NamedTuple):
    """Gauss-Legendre collocation in a step from -1 to 1."""

    ends: Floats  # the nodes, and the end of the step, shape (NODES + 1,)
    to_series: Floats  # from values at the nodes to their Legendre series, shape (NODES, NODES)
    # From values at the nodes to their integrals from -1 to the ends, shape (NODES + 1, NODES).
    to_speeds: Floats
    to_places: Floats  # from values at the nodes to the integrals of these integrals


class Tolerance(NamedTuple):
    """Tolerances of a step, and limits of an integration."""

    position_m: float
    velocity_m_s: float
    min_radius_m: float  # distance of the ground from the Moon's centre
    max_steps: int
