"""Earth orientation: the rotation from the terrestrial to the celestial frame, and its rate.

IAU 2006/2000A precession-nutation with the celestial intermediate origin (IERS Conventions 2010, chapter 5):
a position in the ITRF becomes one in the GCRS by

    r_gcrs = Q(X, Y, s) R3(-ERA(UT1)) W(xp, yp, s') r_itrf          (IERS 2010, eq. 5.1)

with X, Y of the model plus the measured dX, dY, and with xp, yp, UT1 from :mod:`radioloc.earth.eop` plus what
the daily tables leave out: diurnal and semidiurnal ocean tides and libration
(:mod:`radioloc.earth.eop_tides`).
"""

from __future__ import annotations

import warnings
from dataclasses import KW_ONLY, dataclass

import erfa
import numpy as np

from radioloc.constants import SECONDS_PER_DAY
from radioloc.earth.eop import EopTable
from radioloc.earth.eop_tides import libration, ocean_tides
from radioloc.errors import PredictedEopWarning
from radioloc.quantities import EpochsLike, accepts_quantities
from radioloc.time import Epochs
from radioloc.time.smooth import table_of, tabulated
from radioloc.vectors import Floats, Mask, cross_matrices

_ERA_AT_J2000_TURNS = 0.7790572732640
_ERA_EXCESS_TURNS_PER_DAY = 0.00273781191135448
"""Earth rotation angle at J2000 UT1, and turns it gains on whole turns in a day of UT1 (IERS 2010, eq.
5.15)."""

_EXCESS_HIGH = np.round(_ERA_EXCESS_TURNS_PER_DAY * 2.0**32) / 2.0**32
_EXCESS_LOW = _ERA_EXCESS_TURNS_PER_DAY - _EXCESS_HIGH


@dataclass(frozen=True, slots=True, eq=False)
class EarthRotation:
    """Orientation of the Earth at n epochs."""

    rot_itrf_to_gcrs: Floats  # position_gcrs = rot @ position_itrf, (n, 3, 3)
    rot_itrf_to_gcrs_rate: Floats  # by TT, 1/s
    ut1: Epochs  # with all terms asked for
    xp_rad: Floats  # the tables' pole with ocean tides and libration
    yp_rad: Floats
    xp_table_rad: Floats  # the tables' pole alone, as the pole tide takes it
    yp_table_rad: Floats
    predicted: Mask  # whether any of the daily values used is a prediction


@dataclass(frozen=True, eq=False, repr=False)
class EarthOrientation:
    """Model of the Earth's orientation: a table and the terms added to it."""

    table: EopTable
    _: KW_ONLY
    subdaily_tides: bool = True  #: of the oceans; up to 3 cm on the ground by the pole, 4 cm by UT1
    libration: bool = True  #: diurnal of the pole, semidiurnal of UT1; up to 2 mm on the ground each
    zonal_tides: bool = True  #: taken out of UT1 between days and put back; up to 1.2 mm on the ground

    @classmethod
    def default(cls) -> EarthOrientation:
        """All terms, on the C04 and Bulletin A files of the installed ``astropy-iers-data``."""
        return cls(EopTable.packaged())

    def __repr__(self) -> str:
        terms = [name for name in ("subdaily_tides", "libration", "zonal_tides") if getattr(self, name)]
        return (
            f"<EarthOrientation {self.table.first_date} to {self.table.last_date}, measured to "
            f"{self.table.last_measured_date}; {', '.join(terms) or 'no added terms'}>"
        )

    @accepts_quantities
    def evaluate(self, tt: EpochsLike) -> EarthRotation:
        """Orientation at epochs of TT; a :class:`PredictedEopWarning` where any rests on predictions not asked for.

        Examples
        --------
        >>> from radioloc.earth import EarthOrientation
        >>> from radioloc.time import epochs_from_strings
        >>> rotation = EarthOrientation.default().evaluate(epochs_from_strings("2020-12-01", "TT"))
        >>> rotation.rot_itrf_to_gcrs.shape
        (1, 3, 3)
        """
        rotation = self.rotation(tt)
        self.warn_of_predictions(tt, rotation.predicted)
        return rotation

    @accepts_quantities
    def rotation(self, tt: EpochsLike) -> EarthRotation:
        """Return the orientation as :meth:`evaluate` does, without its warning."""
        eop = self.table.interpolate(tt, zonal=self.zonal_tides)
        added, added_rate = self._subdaily(tt.mjd + eop.ut1_minus_tt_s / SECONDS_PER_DAY)
        xp_rad, yp_rad = eop.xp_rad + added[:, 0], eop.yp_rad + added[:, 1]
        ut1 = Epochs.from_jd(tt.jd, tt.fraction + (eop.ut1_minus_tt_s + added[:, 2]) / SECONDS_PER_DAY, "UT1")
        ut1_per_tt = 1.0 + eop.ut1_minus_tt_rate + added_rate[:, 2]

        (x, y), (x_rate, y_rate) = _celestial_pole(tt)
        # The locator s is that of the model's pole; the pole offsets change it by less than 1e-15 rad.
        gcrs_to_cirs = erfa.c2ixys(x + eop.dx_rad, y + eop.dy_rad, erfa.s06(tt.jd, tt.fraction, x, y))
        polar_motion = erfa.pom00(xp_rad, yp_rad, erfa.sp00(tt.jd, tt.fraction))
        rotation = np.swapaxes(erfa.c2tcio(gcrs_to_cirs, earth_rotation_angle(ut1), polar_motion), -1, -2)

        spin_rad_s = 2 * np.pi * (1.0 + _ERA_EXCESS_TURNS_PER_DAY) / SECONDS_PER_DAY * ut1_per_tt
        pole = gcrs_to_cirs[:, 2]
        x_rate, y_rate = x_rate + eop.dx_rate_rad_s, y_rate + eop.dy_rate_rad_s
        z_rate = -(pole[:, 0] * x_rate + pole[:, 1] * y_rate) / pole[:, 2]
        pole_rate = np.stack([x_rate, y_rate, z_rate], axis=-1)
        angular_velocity = spin_rad_s[:, None] * pole + np.cross(pole, pole_rate)
        # Polar motion turns to first order by -yp about x and by -xp about y.
        xp_rate, yp_rate = eop.xp_rate_rad_s + added_rate[:, 0], eop.yp_rate_rad_s + added_rate[:, 1]
        of_pole = cross_matrices(np.stack([-yp_rate, -xp_rate, np.zeros_like(xp_rate)], axis=-1))
        rate = cross_matrices(angular_velocity) @ rotation + rotation @ of_pole
        return EarthRotation(rotation, rate, ut1, xp_rad, yp_rad, eop.xp_rad, eop.yp_rad, eop.predicted)

    @accepts_quantities
    def warn_of_predictions(self, tt: EpochsLike, predicted: Mask) -> None:
        """Give the :class:`PredictedEopWarning` if any epochs rest on predictions that were not asked for."""
        if predicted.any() and self.table.beyond is None:
            days = np.sort(tt[predicted].day_strings())
            warnings.warn(
                f"Earth orientation is predicted, not measured, at {predicted.sum()} of {len(tt)} epochs "
                f"({days[0]} to {days[-1]} TT); measured values end {self.table.last_measured_date}: "
                "update astropy-iers-data when they are out",
                PredictedEopWarning,
                stacklevel=3,
            )

    @accepts_quantities
    def rough_rotation(self, tt: EpochsLike) -> Floats:
        """Rotation from the ITRF to the GCRS without polar motion and tides, 20 m on the ground, shape (n, 3, 3)."""
        x, y = _celestial_pole(tt)[0]
        values, days = self.table.at_0h_utc
        ut1_minus_tt_d = np.interp(tt.mjd, days.mjd, values[:, 0]) / SECONDS_PER_DAY
        angle_rad = earth_rotation_angle(Epochs.from_jd(tt.jd, tt.fraction + ut1_minus_tt_d, "UT1"))
        return np.swapaxes(erfa.rz(angle_rad, erfa.c2ixys(x, y, 0.0)), -1, -2)

    def _subdaily(self, mjd_ut1: Floats) -> tuple[Floats, Floats]:
        """Sum of the chosen terms in xp, yp (rad) and UT1 (s), and its rate; each of shape (n, 3)."""
        value, rate = np.zeros((len(mjd_ut1), 3)), np.zeros((len(mjd_ut1), 3))
        for period, model in ((self.subdaily_tides, ocean_tides), (self.libration, libration)):
            if period:
                term, term_rate = model(mjd_ut1)
                value += term
                rate += term_rate
        return value, rate


def earth_rotation_angle(ut1: Epochs) -> Floats:
    """Earth rotation angle, rad, 0 to 2 pi, shape (n,) (IERS Conventions 2010, eq. 5.15)."""
    # ERFA's ``era00`` rounds the days since J2000 and loses 4e-14 rad; here whole turns are cast off part by part
    # before they are summed, which loses less than 5e-15 rad.
    ut1.require("UT1")
    days = ut1.jd - 2451545.0
    # The high part of the excess has so few bits that its product with a half-integer of days is exact.
    turns = np.mod(days, 1.0) + np.mod(_EXCESS_HIGH * days, 1.0) + _EXCESS_LOW * days
    turns = np.mod(turns + _ERA_AT_J2000_TURNS, 1.0) + ut1.fraction * (1.0 + _ERA_EXCESS_TURNS_PER_DAY)
    return 2 * np.pi * np.mod(turns, 1.0)


def _celestial_pole(tt: Epochs) -> tuple[Floats, Floats]:
    """X and Y of the celestial intermediate pole (IAU 2006/2000A), rad, and their rates, rad/s, shapes (2, n)."""
    # From 1972 to 2049 by polynomials that follow the series of ERFA to 2e-14 rad, 0.1 um on the ground.
    table = table_of("radioloc.earth", "celestial_pole.npy")
    return tabulated(table, tt, lambda at: erfa.xys06a(at.jd, at.fraction)[:2])
