"""Motion of the solid Earth about the centre of mass that it has together with the oceans: up to some 13 mm.

As the tides move the water, the solid Earth with all stations moves the other way. An ephemeris' Earth is
the common centre of mass, but ocean loading is given about the solid Earth's; this is the difference, the
same for all stations. It is contained in loading coefficients that are marked "CMC: YES", and must then be
left out.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radioloc.earth.ocean_tides import sum_of_tides
from radioloc.time import Epochs

# fmt: off
_FES2004_M = np.array([
    (-1.3724e-3, 8.2077e-4, 1.1479e-3, 2.3005e-4, -1.2661e-3, -1.4298e-3),
    (-5.3350e-4, -3.1591e-4, -5.1370e-5, 2.8184e-4, -1.7763e-4, -5.7273e-4),
    (-2.7121e-4, 1.9849e-4, 2.6018e-4, -1.4302e-4, -3.2372e-4, -2.8986e-4),
    (-1.1223e-4, -1.0889e-5, -1.5751e-5, 1.2367e-4, -1.1814e-4, -1.5250e-4),
    (-1.8539e-3, -8.6426e-4, -9.1022e-4, -1.7823e-3, -1.1370e-3, 4.4839e-3),
    (-1.3985e-3, -2.2975e-4, -8.8858e-4, -6.4989e-4, -1.6802e-4, 2.9702e-3),
    (-6.1436e-4, -2.9129e-4, -2.9261e-4, -5.7461e-4, -3.6495e-4, 1.4941e-3),
    (-2.7831e-4, -2.9313e-5, -2.1734e-4, -4.1637e-5, 3.0709e-5, 4.5472e-4),
    (-2.2065e-4, 4.1472e-4, -1.0212e-4, 8.2276e-5, -5.0643e-4, -7.3040e-5),
    (4.6882e-5, 1.8399e-4, -7.4897e-6, 1.3209e-5, -2.7885e-4, 2.0596e-5),
    (1.3687e-4, 3.5475e-5, -2.4093e-5, 3.1666e-7, -1.4899e-4, 2.6146e-6),
])
# fmt: on
"""In-phase and cross-phase parts of x, y and z, m, for M2 S2 N2 K2 K1 O1 P1 Q1 Mf Mm Ssa: ocean tide model
FES2004 (Scherneck, Onsala Space Observatory, file of centre of mass coefficients)."""


def tidal_geocentre_displacement(tt: Epochs, ut1_fraction: ArrayLike) -> NDArray[np.float64]:
    """Displacement of all stations with the solid Earth, against its common centre of mass with the oceans.

    Parameters
    ----------
    tt : Epochs
        Epochs in TT, n of them.
    ut1_fraction : array_like, shape (n,)
        UT1 as a fraction of its day.

    Returns
    -------
    ndarray, shape (n, 3)
        What to add to a station's position, ITRF, m.

    Raises
    ------
    InputError
        The epochs are not in TT, or a shape does not fit.

    Notes
    -----
    IERS Conventions (2010), section 7.1.2: in-phase part times the cosine and cross-phase part times the
    sine of each tide's argument, here with the minor tides. A position about the common centre is one in
    the crust's frame plus this. Ocean tide models differ by some 0.5 mm (K1 and O1 in z, FES2004 and
    GOT5.5).
    """
    in_phase, cross_phase = _FES2004_M[:, 0::2].T, _FES2004_M[:, 1::2].T
    return sum_of_tides(in_phase - 1j * cross_phase, tt, ut1_fraction)
