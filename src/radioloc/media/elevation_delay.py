"""Delay as a function of the elevation alone, such as an analyst's own troposphere."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from radioloc.errors import InputError
from radioloc.media.medium import MIN_ELEVATION_RAD, Leg, LegDelay, LegEnd, Status
from radioloc.vectors import Floats

_STEP_RAD = 1e-5  # of the difference quotient: truncation and rounding are below 1e-6 m/rad at 3 degrees


@dataclass(frozen=True, slots=True)
class ElevationDelay:
    """Medium whose delay is a function of the elevation, for all stations, signals and epochs.

    Parameters
    ----------
    name : str
        Name of the term, by which it is switched off and tabulated.
    delay_m : callable
        Function of elevations without refraction, rad, shape (n,), which returns delays of one way, m, shape (n,). It
        is called with elevations of at least `min_elevation_rad`, and must be smooth there.
    description : str, optional
        Half a sentence for tables and help.
    min_elevation_rad : float, optional
        Observations below are rejected; 3 degrees by default.
    """

    name: str
    delay_m: Callable[[Floats], Floats]
    description: str = "delay by elevation"
    min_elevation_rad: float = MIN_ELEVATION_RAD

    @property
    def limits_rad(self) -> tuple[float, ...]:
        """Lowest elevation of the model."""
        return (self.min_elevation_rad,)

    def prepare(self, end: LegEnd) -> None:
        """Prepare nothing."""

    def delay(self, leg: Leg, prepared: None) -> LegDelay:
        """Return the delay and its derivative by the elevation.

        Raises
        ------
        InputError
            If the function returns another shape, or values that are not finite.
        """
        is_low = leg.elevation.angle_rad < self.min_elevation_rad
        elevation_rad = np.where(is_low, self.min_elevation_rad, leg.elevation.angle_rad)
        # Forward differences, as the model may end at its lowest elevation.
        values_m = np.array([self.delay_m(elevation_rad + k * _STEP_RAD) for k in range(3)], dtype=float)
        if values_m.shape != (3, len(leg)) or not np.isfinite(values_m).all():
            raise InputError(
                f"medium {self.name}: expected a finite delay for each of {len(leg)} elevations, got values of shape "
                f"{values_m.shape[1:]}, {np.count_nonzero(~np.isfinite(values_m[:1]))} not finite"
            )
        derivative_m_rad = (4.0 * values_m[1] - 3.0 * values_m[0] - values_m[2]) / (2.0 * _STEP_RAD)
        status = np.where(is_low, Status.OUTSIDE_MODEL, Status.OK).astype(np.int8)
        return LegDelay(np.where(is_low, 0.0, values_m[0]), status, by_elevation_m_rad=derivative_m_rad)
