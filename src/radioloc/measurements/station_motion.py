"""Barycentric motion of stations near the instants of transmission and reception."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from radioloc.constants import C_M_S, EARTH_ROTATION_RAD_S, L_B, L_G, SECONDS_PER_DAY
from radioloc.earth.geodesy import geodetic_from_itrf
from radioloc.earth.ocean_loading import TIDAL_GEOCENTRE_M, loading_itrf_m, sum_of_tides
from radioloc.earth.solid_tide import pole_tide_displacement, solid_earth_tide
from radioloc.earth.stations import Station
from radioloc.ephemeris import EarthState
from radioloc.measurements.light_path import MovingPoint
from radioloc.measurements.physical_model import PhysicalModel
from radioloc.media.medium import StationState
from radioloc.time import Epochs, geocentric_tdb_minus_tt, topocentric_tdb_minus_tt
from radioloc.vectors import Floats, Mask, cross, dot, east_north_up, length, rotated


@dataclass(frozen=True, slots=True, eq=False)
class StationMotion(StationState):
    """States of the station of each observation near an instant."""

    point: MovingPoint  # in the BCRS, from the geocentre at the reference epoch
    tdb_minus_tt_s: Floats  # at the station
    topocentric_s: Floats  # part of TDB - TT that depends on the place, v_E . r / c^2
    tdb_rate: Floats  # of TDB - TT at the station
    geocentric_tdb_rate: Floats  # of the part that is independent of the place
    rot_itrf_to_gcrs: Floats  # shape (n, 3, 3)
    predicted_eop: Mask  # whether Earth orientation was a prediction

    def tdb_minus_tt_at(self, offset_s: Floats) -> Floats:
        """Return TDB - TT at the station at a near instant, s, shape (n,)."""
        return self.tdb_minus_tt_s + self.tdb_rate * (offset_s - self.point.offset_s)

    def geocentric_tdb_minus_tt_at(self, offset_s: Floats) -> Floats:
        """Return TDB - TT at the geocentre at a near instant, s, shape (n,)."""
        geocentric_s = self.tdb_minus_tt_s - self.topocentric_s
        return geocentric_s + self.geocentric_tdb_rate * (offset_s - self.point.offset_s)


def station_motion(
    model: PhysicalModel,
    stations: tuple[Station, ...],
    station_index: NDArray[np.int32],
    reference: Epochs,
    reference_earth: EarthState,
    offset_s: Floats,
) -> StationMotion:
    """Return the motion of stations by index, at most some seconds from the reference epochs (TDB)."""
    # The event's BCRS place is x_E(TDB) + r - r (U/c^2 + L_B - L_G) - v_E (v_E . r) / (2 c^2), with r the GCRS position
    # scaled for TT, as ITRF coordinates are, and U the potential of Sun and Moon at the geocentre (Moyer 2003, eq. 4-10
    # and 4-17; IERS Conventions 2010, section 11.1). Terms with the Earth's acceleration are below 3 micrometres.
    tdb = reference.shifted(offset_s)
    earth, bodies = model.ephemeris.states(("moon", "sun"), tdb)
    (moon_m, _), (sun_m, _) = bodies.values()
    geocentric_s = geocentric_tdb_minus_tt(tdb)
    tt = Epochs.from_jd(tdb.jd, tdb.fraction - geocentric_s / SECONDS_PER_DAY, "TT")
    rotation = model.earth.rotation(tt)
    rot = rotation.rot_itrf_to_gcrs
    rest_m = np.empty_like(moon_m)
    for i, station in enumerate(stations):
        rows = np.flatnonzero(station_index == i)
        has_velocity = model.has("station_velocity")
        rest_m[rows] = station.position_at(tt[rows]) if has_velocity else station.itrf2020[0]
    itrf_m = rest_m
    if model.has("solid_earth_tide"):
        moon_itrf_m, sun_itrf_m = (rotated(np.swapaxes(rot, -1, -2), body_m) for body_m in (moon_m, sun_m))
        itrf_m = itrf_m + solid_earth_tide(rest_m, moon_itrf_m, sun_itrf_m, tt, rotation.ut1.fraction)
    if model.has("pole_tide"):
        itrf_m = itrf_m + pole_tide_displacement(rest_m, rotation.xp_table_rad, rotation.yp_table_rad, tt)
    tides_m = np.zeros((len(stations), *TIDAL_GEOCENTRE_M.shape), dtype=np.complex128)
    for of_station_m, station in zip(tides_m, stations, strict=True):
        loading = station.ocean_loading if model.has("ocean_loading") else None
        if loading is not None:
            of_station_m += loading_itrf_m(loading, station.itrf_m)
        if model.has("tidal_geocentre") and (loading is None or not loading.geocentre_included):
            of_station_m += TIDAL_GEOCENTRE_M
    if tides_m.any():
        itrf_m = itrf_m + sum_of_tides(tides_m[station_index], tt, rotation.ut1.fraction)
    places = geodetic_from_itrf(_itrf_m(stations))
    up_itrf = east_north_up(places.longitude_rad, places.latitude_rad)[station_index, 2]

    gcrs_m = rotated(rot, itrf_m)
    gcrs_velocity_m_s = rotated(rotation.rot_itrf_to_gcrs_rate, itrf_m)
    # TT at the station differs from TT at the geocentre by up to 2 microseconds, in which it moves 1 mm.
    topocentric_s = topocentric_tdb_minus_tt(earth.velocity_m_s, gcrs_m)
    gcrs_m = gcrs_m - gcrs_velocity_m_s * topocentric_s[:, None]

    v_m_s = earth.velocity_m_s
    constants = model.ephemeris.constants
    potential = constants.gm_sun_m3_s2 / length(sun_m)
    potential = (potential + constants.gm_moon_m3_s2 / length(moon_m)) / C_M_S**2
    bcrs_m = gcrs_m
    if model.has("earth_scale"):
        bcrs_m = bcrs_m - gcrs_m * (potential + (L_B - L_G))[:, None]
    if model.has("earth_lorentz"):
        bcrs_m = bcrs_m - v_m_s * (dot(v_m_s, gcrs_m) / (2.0 * C_M_S**2))[:, None]
    geocentric_rate = dot(v_m_s, v_m_s) / (2.0 * C_M_S**2) + potential - (L_B - L_G)
    return StationMotion(
        point=MovingPoint(
            offset_s, geocentre_displacement_m(reference_earth, offset_s) + bcrs_m, v_m_s + gcrs_velocity_m_s
        ),
        gcrs_m=gcrs_m,
        gcrs_velocity_m_s=gcrs_velocity_m_s,
        up_gcrs=rotated(rot, up_itrf),
        up_rate_gcrs=rotated(rotation.rot_itrf_to_gcrs_rate, up_itrf),
        pole_gcrs=rot[:, :, 2],
        tdb_minus_tt_s=geocentric_s + topocentric_s,
        topocentric_s=topocentric_s,
        tdb_rate=geocentric_rate
        + topocentric_tdb_minus_tt(v_m_s, gcrs_velocity_m_s)
        + topocentric_tdb_minus_tt(earth.acceleration_m_s2, gcrs_m),
        geocentric_tdb_rate=geocentric_rate,
        rot_itrf_to_gcrs=rot,
        latitude_rad=places.latitude_rad[station_index],
        height_m=places.height_m[station_index],
        predicted_eop=rotation.predicted,
    )


def rough_station_motion(
    model: PhysicalModel,
    stations: tuple[Station, ...],
    station_index: NDArray[np.int32],
    tt: Epochs,
    earth: EarthState,
) -> MovingPoint:
    """Return the motion of stations of all first ends and all second ends near the reference epochs, to some 20 m."""
    rot = model.earth.rough_rotation(tt)
    path = np.tile(np.arange(len(tt)), 2)
    gcrs_m = rotated(rot[path], _itrf_m(stations)[station_index])
    spin_rad_s = EARTH_ROTATION_RAD_S * rot[path, :, 2]
    return MovingPoint(
        np.zeros(len(station_index)), gcrs_m, earth.velocity_m_s[path] + cross(spin_rad_s, gcrs_m)
    )


def _itrf_m(stations: tuple[Station, ...]) -> Floats:
    return np.reshape([station.itrf_m for station in stations], (-1, 3))


def geocentre_displacement_m(earth: EarthState, offset_s: Floats) -> Floats:
    """Return the displacement of the geocentre since the reference epochs, m, to 5e-9 m after 3 s, shape (n, 3)."""
    t = offset_s[:, None]
    return earth.velocity_m_s * t + earth.acceleration_m_s2 * (0.5 * t**2)
