"""Data of compiled forces and of the compiled integration, in a module that needs no compiler."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from radioloc.vectors import Floats

PARTS = (
    *("central", "harmonics", "tides", "earth", "sun", "venus", "jupiter", "saturn"),
    *("figures", "relativity", "sunlight", "moonlight", "given"),
)
"""Accelerations one by one, as :func:`accelerations` has them."""
CENTRAL, HARMONICS, TIDES, EARTH, SUN = range(5)
FIGURES, RELATIVITY, SUNLIGHT, MOONLIGHT, GIVEN = range(8, 13)

# Quantities of the table of bodies: positions of Earth to Saturn, the rotation to the field's axes row by row,
# velocities of the Earth, the Sun and, seen from the barycentre, the Moon.
ROTATION, EARTH_VELOCITY, SUN_VELOCITY, MOON_VELOCITY, QUANTITIES = 15, 24, 27, 30, 33

ACTS, OF_RTN, NORMAL, FIRST = 0, 1, 2, 5
"""Columns of a given acceleration: 1 where it acts, 1 where its axes are radial, transverse and normal, the normal of
a plane that these keep to (zeros: that of the orbit), components."""
COMPONENTS = 9
"""Constant, cosine and sine, along three axes each."""


class ForceData(NamedTuple):
    """Data on which the accelerations depend."""

    table: Floats  # Chebyshev series of the quantities, shape (n_segments, QUANTITIES, n_coefficients)
    start_s: float  # of the first segment
    length_s: float  # of each
    gm: Floats  # Moon, Earth, Sun, Venus, Jupiter, Saturn
    radius_m: float  # of the harmonics
    series: Floats
    gradient_series: Floats
    recursion: Floats
    on: NDArray[np.bool_]  # which of PARTS are computed
    scales: Floats  # by which each is multiplied: 1, or k2 and the radiation coefficient
    given: Floats  # shape (n, FIRST + COMPONENTS)
    phase: Floats  # directions from which the phase of periodic accelerations is counted, shape (2, 3)
    permanent: Floats  # tide-raising tensor in the field's coefficients, its axes, 1/s^2, shape (3, 3)


DONE, STUCK, IN_MOON, IN_EARTH, TOO_MANY = range(5)
"""Outcomes of an integration: at its end, steps too small, in the Moon, in the Earth, too many steps."""

SHORTEST_S = 1e-6
NODES = 16
"""In a step of the integration; about a low orbit 12 cost a quarter more, and 20 are no quicker."""


class Collocation(NamedTuple):
    """Gauss-Legendre collocation in a step, which goes from -1 to 1."""

    ends: Floats  # the nodes, and the end of the step, shape (NODES + 1,)
    to_series: Floats  # from values at the nodes to their Legendre series, shape (NODES, NODES)
    once: Floats  # from values at the nodes to their integrals from -1 to the ends, shape (NODES + 1, NODES)
    twice: Floats  # likewise, to the integrals of these


class Tolerance(NamedTuple):
    """Tolerances of a step, and limits of an integration."""

    position_m: float
    velocity_m_s: float
    lowest_m: float  # distance from the centre below which there is ground
    most_steps: int
