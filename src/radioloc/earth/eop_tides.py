"""Tides and libration in polar motion and UT1: the terms that daily tables of Earth orientation leave out.

Three models of the IERS Conventions (2010), each a sum of sines over known arguments, evaluated for all
epochs at once with its time derivative:

- :func:`zonal_tides`: UT1, 5 days to 18.6 years (section 8.1). They are in the tables; they are taken out
  before interpolation between days, and put back.
- :func:`ocean_tides`: xp, yp and UT1, near one and two cycles a day (section 8.2); up to 1 mas and 90 us.
- :func:`libration`: xp and yp near one, UT1 near two cycles a day, from the Earth's triaxial figure (section
  5.5.1 and 5.5.3.3); up to 45 uas and 4 us.

The last two are absent from C04 and Bulletin A and are added after interpolation.
"""

from __future__ import annotations

import erfa
import numpy as np

from radioloc.constants import ARCSEC_RAD, SECONDS_PER_DAY
from radioloc.time.smooth import table_of
from radioloc.vectors import Floats

_DAYS_PER_CENTURY = 36525.0
_MJD_J2000 = 51544.5
_UAS_RAD = 1e-6 * ARCSEC_RAD
_EOP_UNITS = np.array([_UAS_RAD, _UAS_RAD, 1e-6])

_DELAUNAY_RATES_RAD_S = np.array(
    [1717915923.2178, 129596581.0481, 1739527262.8478, 1602961601.2090, -6962890.5431]
) * (ARCSEC_RAD / (_DAYS_PER_CENTURY * SECONDS_PER_DAY))
"""Linear terms of l, l', F, D, Omega (IERS 2010 eq. 5.43, arcsec per Julian century); enough for derivatives."""

_ORTHOTIDE_FACTORS = np.array(
    [(0.0298, 0.1408, 0.0805, 0.6002, 0.3025, 0.1517), (0.0200, 0.0905, 0.0638, 0.3476, 0.1645, 0.0923)]
)
"""Factors that make the potential and its values two days before and after orthogonal (Groves and Reynolds 1975):
diurnal and semidiurnal band."""

# fmt: off
_ORTHOWEIGHTS = np.array([
    [(-6.77832, -14.86323, 0.47884, -1.45303, 0.16406, 0.42030),
     (0.09398, 25.73054, -4.77974, 0.28080, 1.94539, -0.73089)],
    [(14.86283, -6.77846, 1.45234, 0.47888, -0.42056, 0.16469),
     (15.30276, -4.30615, 0.07564, 2.28321, -0.45717, -1.62010)],
    [(-1.76335, 1.03364, -0.27553, 0.34569, -0.12343, -0.10146),
     (-0.47119, 1.28997, -0.19336, 0.02724, 0.08955, 0.04726)],
])
# fmt: on
"""Response of xp and yp (microarcseconds) and UT1 (microseconds) to the orthotides (Ray et al. 1994, Science 264,
830-832), diurnal and semidiurnal: in-phase and quadrature of three orthotides."""

_GMST_RATE_S_CY = 3155760000.0 + 8640184.812866
"""Linear term of GMST (Aoki et al. 1982), which chapter 5 uses for these small terms; seconds of time a
century."""


def zonal_tides(centuries_tt: Floats) -> tuple[Floats, Floats]:
    """Effect of the zonal tides on UT1, s, and its rate, s/s; Julian centuries of TT since J2000."""
    # IERS Conventions (2010), eq. 8.1 and Table 8.1 (Yoder et al. 1981; Wahr and Bergen 1986; Kantha et al. 1998).
    table = table_of("radioloc.earth", "ut1_zonal_tides.csv")
    angles = delaunay_arguments_rad(centuries_tt) @ table[:, :5].T
    rates = table[:, :5] @ _DELAUNAY_RATES_RAD_S
    value, rate = _harmonic_sum(angles, rates, table[:, 5:6] * 1e-4, table[:, 6:7] * 1e-4)
    return value[:, 0], rate[:, 0]


def ocean_tides(mjd_ut1: Floats) -> tuple[Floats, Floats]:
    """Variations of xp, yp (rad) and UT1 (s) by ocean tides, and their rates, (n, 3); the date may be UT1 or UTC."""
    # The conventional model is a response to the tidal potential and its values two days before and after. As these are
    # sums over the same lines, the response is worked out for each line, and one sum over 71 lines remains.
    order, _, phase, frequency = table_of("radioloc.earth", "rotation_tide_lines.csv").T
    # A diurnal line is a sine where a semidiurnal one is a cosine.
    angles = np.multiply.outer(mjd_ut1 - 37076.5, frequency) + (phase - np.where(order == 1, np.pi / 2, 0.0))
    sine, cosine = _ocean_tide_coefficients()
    value, rate = _harmonic_sum(angles, frequency / SECONDS_PER_DAY, sine, cosine)
    return value * _EOP_UNITS, rate * _EOP_UNITS


def libration(mjd_ut1: Floats) -> tuple[Floats, Floats]:
    """Diurnal libration of the pole (rad) and semidiurnal libration of UT1 (s), and their rates, (n, 3)."""
    # IERS Conventions (2010), Tables 5.1a (its ten diurnal terms; those of long period are in the observed pole) and
    # 5.1b. Arguments are GMST + pi, for which one float for the date in UT1 suffices, and the Delaunay variables.
    centuries = (mjd_ut1 - _MJD_J2000) / _DAYS_PER_CENTURY
    gmst_s = 67310.54841 + centuries * (_GMST_RATE_S_CY + centuries * (0.093104 - 6.2e-6 * centuries))
    chi = np.fmod(gmst_s, SECONDS_PER_DAY) * (2 * np.pi / SECONDS_PER_DAY) + np.pi
    arguments = np.column_stack([chi, delaunay_arguments_rad(centuries)])
    chi_rate = _GMST_RATE_S_CY * (2 * np.pi / SECONDS_PER_DAY) / (_DAYS_PER_CENTURY * SECONDS_PER_DAY)
    argument_rates = np.concatenate([[chi_rate], _DELAUNAY_RATES_RAD_S])
    sums = [
        _harmonic_sum(arguments @ t[:, :6].T, t[:, :6] @ argument_rates, t[:, 6::2], t[:, 7::2])
        for t in (
            table_of("radioloc.earth", "pole_libration.csv"),
            table_of("radioloc.earth", "ut1_libration.csv"),
        )
    ]
    value, rate = (np.hstack(parts) * _EOP_UNITS for parts in zip(*sums, strict=True))
    return value, rate


def delaunay_arguments_rad(centuries: Floats) -> Floats:
    """Return the Delaunay arguments l, l', F, D, Omega, rad, (n, 5), at centuries from J2000 (IERS 2010 eq. 5.43)."""
    return np.column_stack(
        [f(centuries) for f in (erfa.fal03, erfa.falp03, erfa.faf03, erfa.fad03, erfa.faom03)]
    )


def _harmonic_sum(angles: Floats, rates: Floats, sine: Floats, cosine: Floats) -> tuple[Floats, Floats]:
    """Sum of sines and cosines of angles (n, m), and its derivative by the rates (m,); coefficients (m, k)."""
    s, c = np.sin(angles), np.cos(angles)
    return s @ sine + c @ cosine, c @ (rates[:, None] * sine) - s @ (rates[:, None] * cosine)


def _ocean_tide_coefficients() -> tuple[Floats, Floats]:
    """Sine and cosine coefficients of xp, yp (uas) and UT1 (us) for each tidal line, each of shape (71, 3)."""
    # For a line of height h and frequency w, potential values two days apart sum to 2 h cos(2 w) and differ by
    # 2 h sin(2 w) times the line itself, in phase and in quadrature; the three orthotides then are real factors.
    order, height, _, frequency = table_of("radioloc.earth", "rotation_tide_lines.csv").T
    band = order.astype(np.int64) - 1
    f0, f1, f2, f3, f4, f5 = _ORTHOTIDE_FACTORS[band].T
    lag_cosine, lag_sine = 2.0 * np.cos(2.0 * frequency), 2.0 * np.sin(2.0 * frequency)
    orthotides = height[:, None] * np.column_stack(
        [f0, f1 - f2 * lag_cosine, f3 - f4 * lag_cosine + f5 * lag_sine]
    )
    weights = _ORTHOWEIGHTS.reshape(3, 2, 3, 2)[:, band]
    in_phase, quadrature = np.moveaxis(weights, -1, 0)
    return -np.einsum("lk,elk->le", orthotides, quadrature), np.einsum("lk,elk->le", orthotides, in_phase)
