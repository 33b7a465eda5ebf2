"""Displacement of a station by the load of the ocean tides: millimetres inland, centimetres at some coasts.

From a station's coefficients, in the manner of the IERS Conventions (2010), section 7.1.2; see
:mod:`radioloc.earth.ocean_tides`. Coefficients are commonly given against the centre of mass of the solid
Earth (those that ship are). The motion of that centre about the one of Earth and oceans together is another
term: :mod:`radioloc.earth.tidal_geocentre`; leave it out with coefficients that contain it ("CMC: YES").
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radioloc.earth.blq import BlqCoefficients
from radioloc.earth.geodesy import rot_itrf_to_enu
from radioloc.earth.ocean_tides import sum_of_tides
from radioloc.errors import InputError
from radioloc.time import Epochs

_WEST_SOUTH_UP_TO_ENU = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
"""From the order of a BLQ record (up, west, south)."""


def ocean_loading_displacement(
    coefficients: BlqCoefficients, station_itrf_m: ArrayLike, tt: Epochs, ut1_fraction: ArrayLike
) -> NDArray[np.float64]:
    """Displacement of a station by ocean tide loading.

    Parameters
    ----------
    coefficients : BlqCoefficients
        The station's coefficients.
    station_itrf_m : array_like, shape (3,) or (n, 3)
        The station, ITRF, m.
    tt : Epochs
        Epochs in TT, n of them.
    ut1_fraction : array_like, shape (n,)
        UT1 as a fraction of its day (UTC instead costs less than some micrometres).

    Returns
    -------
    ndarray, shape (n, 3)
        What to add to the station's position, ITRF, m.

    Raises
    ------
    InputError
        The epochs are not in TT, or a shape does not fit.
    """
    enu = ocean_loading_enu(coefficients, tt, ut1_fraction)
    station = np.asarray(station_itrf_m, dtype=np.float64)
    if station.shape not in ((3,), (len(tt), 3)):
        raise InputError(f"stations have shape {station.shape}; give (3,) or ({len(tt)}, 3)")
    return np.einsum("...ij,...i->...j", rot_itrf_to_enu(station), enu)


def ocean_loading_enu(
    coefficients: BlqCoefficients, tt: Epochs, ut1_fraction: ArrayLike
) -> NDArray[np.float64]:
    """Displacement of a station by ocean tide loading to the east, the north and up, m, shape (n, 3).

    Parameters and errors as :func:`ocean_loading_displacement`.
    """
    amplitudes_m = coefficients.amplitude_m * np.exp(-1j * coefficients.phase_lag_rad)
    return sum_of_tides(amplitudes_m, tt, ut1_fraction) @ _WEST_SOUTH_UP_TO_ENU.T
