"""In what a simulated world can depart from the model used to fit it, whether the amounts are known or drawn."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

NO_OFFSET = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class ModelErrors:
    """Amounts by which places, orientations, instruments and air depart from the model, real minus modelled.

    Those of :class:`~radioloc.simulation.truth.Truth` are what they are, those of
    :class:`~radioloc.simulation.departures.Spread` standard deviations.

    Parameters
    ----------
    moon_m : tuple of float
        Moon off its ephemeris, away from the Earth, along its orbit and normal to it, m.
    libration_rad : tuple of float
        Moon turned about its principal axes x (to the Earth), y and z (the pole), rad.
    station_enu_m : mapping of str to (float, float, float)
        Stations off their catalogue positions to the east, to the north and up, m.
    ut1_s : float
        UT1 off the table, s.
    pole_rad : tuple of float
        Pole off the table, xp and yp, rad.
    range_bias_m : mapping of str to float
        Added to the ranges that a station receives, m.
    zenith_delay_m : mapping of str to float
        Tropospheric delay in a station's zenith that the model lacks, m.
    tec_tecu : mapping of str to float
        Vertical electron content that the model lacks, 1e16 per square metre.

    Notes
    -----
    Names of stations are those of the catalogue or aliases.
    """

    moon_m: tuple[float, float, float] = NO_OFFSET
    libration_rad: tuple[float, float, float] = NO_OFFSET
    station_enu_m: Mapping[str, tuple[float, float, float]] = field(default_factory=dict)
    ut1_s: float = 0.0
    pole_rad: tuple[float, float] = (0.0, 0.0)
    range_bias_m: Mapping[str, float] = field(default_factory=dict)
    zenith_delay_m: Mapping[str, float] = field(default_factory=dict)
    tec_tecu: Mapping[str, float] = field(default_factory=dict)
