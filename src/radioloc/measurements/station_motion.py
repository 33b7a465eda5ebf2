"""Where stations on Earth are, seen from the barycentre, near the instant at which a signal leaves or arrives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from radioloc.constants import C_M_S, L_B, L_G, SECONDS_PER_DAY
from radioloc.earth.geodesy import geodetic_from_itrf, rot_itrf_to_enu
from radioloc.earth.ocean_loading import ocean_loading_displacement, tidal_geocentre_displacement
from radioloc.earth.pole_tide import pole_tide_displacement
from radioloc.earth.solid_tide import solid_earth_tide
from radioloc.earth.stations import Station
from radioloc.ephemeris import EarthState
from radioloc.measurements.light_path import MovingPoint
from radioloc.measurements.physical_model import PhysicalModel
from radioloc.media.medium import StationState
from radioloc.time import Epochs, geocentric_tdb_minus_tt, topocentric_tdb_minus_tt


@dataclass(frozen=True, slots=True, eq=False)
class StationMotion(StationState):
    """One station per observation, near one instant each."""

    point: MovingPoint  # in the BCRS, from the geocentre at the reference epoch
    tdb_minus_tt_s: NDArray[np.float64]  # at the station
    topocentric_s: NDArray[np.float64]  # the part of it that depends on the place, v_E . r / c^2
    tdb_rate: NDArray[np.float64]  # of TDB - TT at the station
    geocentric_tdb_rate: NDArray[np.float64]  # of the part that does not depend on the place
    rot_itrf_to_gcrs: NDArray[np.float64]  # shape (n, 3, 3)
    predicted_eop: NDArray[np.bool_]  # whether Earth orientation was a prediction

    def tdb_minus_tt_at(self, offset_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """TDB - TT at the station at another instant nearby, s, shape (n,)."""
        return self.tdb_minus_tt_s + self.tdb_rate * (offset_s - self.point.offset_s)

    def geocentric_tdb_minus_tt_at(self, offset_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """TDB - TT at the geocentre at another instant nearby, s, shape (n,)."""
        there_s = self.tdb_minus_tt_s - self.topocentric_s
        return there_s + self.geocentric_tdb_rate * (offset_s - self.point.offset_s)


def station_motion(
    model: PhysicalModel,
    stations: tuple[Station, ...],
    which: NDArray[np.int32],
    reference: Epochs,
    reference_earth: EarthState,
    offset_s: NDArray[np.float64],
) -> StationMotion:
    """Motion of stations, `which` of them for each observation, at most some seconds from the reference epochs (TDB).

    The event's BCRS place is x_E(TDB) + r - r (U/c^2 + L_B - L_G) - v_E (v_E . r) / (2 c^2), with r the GCRS position
    scaled for TT, as ITRF coordinates are, and U the potential of Sun and Moon at the geocentre (Moyer 2003, eq. 4-10
    and 4-17; IERS Conventions 2010, section 11.1). Terms with the Earth's acceleration are below 3 micrometres.
    """
    tdb = reference.shifted(offset_s)
    earth = model.ephemeris.earth(tdb)
    geocentric_s = geocentric_tdb_minus_tt(tdb)
    tt = Epochs.from_jd(tdb.jd, tdb.fraction - geocentric_s / SECONDS_PER_DAY, "TT")
    rotation = model.earth.evaluate(tt)
    rot = rotation.rot_itrf_to_gcrs
    moon_m, _ = model.ephemeris.geocentric("moon", tdb)
    sun_m, _ = model.ephemeris.geocentric("sun", tdb)
    itrf_m, up_itrf = np.empty_like(moon_m), np.empty_like(moon_m)
    latitude_rad, height_m = np.empty(len(tdb)), np.empty(len(tdb))
    geocentre_m = np.zeros(3)
    if model.has("tidal_geocentre"):
        geocentre_m = tidal_geocentre_displacement(tt, rotation.ut1.fraction)
    to_itrf = np.swapaxes(rot, -1, -2)
    moon_itrf_m, sun_itrf_m = (
        np.einsum("nij,nj->ni", to_itrf, moon_m),
        np.einsum("nij,nj->ni", to_itrf, sun_m),
    )
    for i, station in enumerate(stations):
        rows = np.flatnonzero(which == i)
        here, ut1 = tt[rows], rotation.ut1.fraction[rows]
        moves = model.has("station_velocity")
        rest_m = station.position_at(here) if moves else np.tile(station.itrf2020[0], (len(rows), 1))
        moved_m = rest_m
        if model.has("solid_earth_tide"):
            moved_m = moved_m + solid_earth_tide(rest_m, moon_itrf_m[rows], sun_itrf_m[rows], here, ut1)
        if model.has("pole_tide"):
            pole_rad = rotation.xp_table_rad[rows], rotation.yp_table_rad[rows]
            moved_m = moved_m + pole_tide_displacement(rest_m, *pole_rad, here)
        if model.has("ocean_loading") and station.ocean_loading is not None:
            moved_m = moved_m + ocean_loading_displacement(station.ocean_loading, rest_m, here, ut1)
        itrf_m[rows] = moved_m
        place = geodetic_from_itrf(station.itrf_m)
        latitude_rad[rows], height_m[rows] = place.latitude_rad, place.height_m
        up_itrf[rows] = rot_itrf_to_enu(station.itrf_m)[2]
    itrf_m += geocentre_m

    gcrs_m = np.einsum("nij,nj->ni", rot, itrf_m)
    gcrs_velocity_m_s = np.einsum("nij,nj->ni", rotation.rot_itrf_to_gcrs_rate, itrf_m)
    # The station's own TT is later or earlier than the geocentre's by up to 2 microseconds, in which it moves 1 mm.
    topocentric_s = topocentric_tdb_minus_tt(earth.velocity_m_s, gcrs_m)
    gcrs_m = gcrs_m - gcrs_velocity_m_s * topocentric_s[:, None]

    v_m_s = earth.velocity_m_s
    constants = model.ephemeris.constants
    potential = constants.gm_sun_m3_s2 / np.linalg.norm(sun_m, axis=-1)
    potential = (potential + constants.gm_moon_m3_s2 / np.linalg.norm(moon_m, axis=-1)) / C_M_S**2
    bcrs_m = gcrs_m
    if model.has("earth_scale"):
        bcrs_m = bcrs_m - gcrs_m * (potential + (L_B - L_G))[:, None]
    if model.has("earth_lorentz"):
        bcrs_m = bcrs_m - v_m_s * (np.einsum("ni,ni->n", v_m_s, gcrs_m) / (2.0 * C_M_S**2))[:, None]
    geocentric_rate = np.einsum("ni,ni->n", v_m_s, v_m_s) / (2.0 * C_M_S**2) + potential - (L_B - L_G)
    return StationMotion(
        point=MovingPoint(
            offset_s, geocentre_displacement_m(reference_earth, offset_s) + bcrs_m, v_m_s + gcrs_velocity_m_s
        ),
        gcrs_m=gcrs_m,
        gcrs_velocity_m_s=gcrs_velocity_m_s,
        up_gcrs=np.einsum("nij,nj->ni", rot, up_itrf),
        up_rate_gcrs=np.einsum("nij,nj->ni", rotation.rot_itrf_to_gcrs_rate, up_itrf),
        pole_gcrs=rot[:, :, 2],
        tdb_minus_tt_s=geocentric_s + topocentric_s,
        topocentric_s=topocentric_s,
        tdb_rate=geocentric_rate
        + topocentric_tdb_minus_tt(v_m_s, gcrs_velocity_m_s)
        + topocentric_tdb_minus_tt(earth.acceleration_m_s2, gcrs_m),
        geocentric_tdb_rate=geocentric_rate,
        rot_itrf_to_gcrs=rot,
        latitude_rad=latitude_rad,
        height_m=height_m,
        predicted_eop=rotation.predicted,
    )


def geocentre_displacement_m(earth: EarthState, offset_s: NDArray[np.float64]) -> NDArray[np.float64]:
    """How far the geocentre has moved since the reference epochs, m, shape (n, 3).

    Second order in time; the next term, from the Earth's orbit about the Sun, is 5e-9 m after 3 s.
    """
    t = offset_s[:, None]
    return earth.velocity_m_s * t + earth.acceleration_m_s2 * (0.5 * t**2)
