"""Corrections to the Moon's position, librations, Love numbers and scale of lengths.

The position is along the direction from the Earth, along the orbit and along its normal. Errors of position and
librations have a constant part and a part for each session.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np

from radioloc.earth.eop_tides import delaunay_arguments_rad
from radioloc.lunar import rot_icrf_to_pa
from radioloc.lunar.tide import solid_tide
from radioloc.parameters.kind import Members, ParameterKind, Scope, Sigmas, all_observations
from radioloc.parameters.rows import ObservationRows
from radioloc.time import Epochs
from radioloc.vectors import Floats, cross, dot, rtn_axes

_MJD_2000, _DAYS_PER_YEAR, _DAYS_PER_CENTURY = 51544.5, 365.25, 36525.0
_LONGITUDE_TERMS = {"365d": (0, 1, 0, 0, 0), "206d": (2, 0, 0, -2, 0), "1095d": (-2, 0, 2, 0, 0)}
"""Forced librations in longitude by period, as multiples of the arguments l, l', F, D and Omega: l', 2l - 2D, 2F - 2l.

Their amplitudes depend on dissipation in the Moon, so they are adjusted to laser ranges beside an integrated libration
(Pavlov, Williams and Suvorkin 2016, Celest. Mech. Dyn. Astron. 126, 61).
"""


def _moon_axes(rows: ObservationRows) -> list[Floats]:
    model = rows.model

    def axes_pa(tdb: Epochs) -> Floats:
        axes = rtn_axes(*model.ephemeris.geocentric("moon", tdb))
        return axes @ np.swapaxes(rot_icrf_to_pa(model.libration.angles(tdb)[0]), -1, -2)

    return rows.displacements(axes_pa)


def _moon_position(rows: ObservationRows) -> Floats:
    return rows.displacement_partials(rows.evaluate_unpredicted(_moon_axes))[:, None, :]


def _libration(rows: ObservationRows) -> Floats:
    # A rotation by e about an axis moves the target by e x r, so that the partial is r x by_position along the axis.
    return cross(rows.target_pa_m, rows.computed.by_position_pa)[:, None, :]


def _longitude_libration(rows: ObservationRows) -> Floats:
    centuries = (rows.observations.epoch.mjd[rows.rows] - _MJD_2000) / _DAYS_PER_CENTURY
    angles = delaunay_arguments_rad(centuries) @ np.array([*_LONGITUDE_TERMS.values()]).T
    waves = np.stack([np.cos(angles), np.sin(angles)], axis=-1).reshape(len(rows), 1, -1)
    return _libration(rows)[..., 2:] * waves


def _love_numbers(rows: ObservationRows) -> Floats:
    model, positions = rows.model, np.atleast_2d(rows.target_pa_m)
    places, place_of_row = np.unique(positions, axis=0, return_inverse=True)
    if not len(places):
        return np.zeros((0, 1, 2))
    permanent: Literal["included", "removed"] = "included" if model.has("lunar_tide_constant") else "removed"
    constants = model.ephemeris.constants
    units = [replace(constants, h2=h2, l2=l2) for h2, l2 in ((1.0, 0.0), (0.0, 1.0))]

    def displacements(tdb: Epochs) -> Floats:
        to_pa = rot_icrf_to_pa(model.libration.angles(tdb)[0])
        moon_m, _ = model.ephemeris.geocentric("moon", tdb)
        sun_m, _ = model.ephemeris.geocentric("sun", tdb)
        earth_pa_m = np.einsum("nij,nj->ni", to_pa, -moon_m)
        sun_pa_m = np.einsum("nij,nj->ni", to_pa, sun_m - moon_m)
        # A spacecraft, whose position is the offset from its trajectory, zeros, has no tide.
        of_places = [
            [solid_tide(place, earth_pa_m, sun_pa_m, unit, permanent) for unit in units]
            if place.any()
            else [np.zeros_like(earth_pa_m)] * 2
            for place in places
        ]
        return np.concatenate([np.array(of_place).swapaxes(0, 1) for of_place in of_places], axis=1)

    columns = rows.displacement_partials(rows.displacements(displacements)).reshape(len(rows), len(places), 2)
    return columns[np.arange(len(rows)), place_of_row.reshape(-1)][:, None, :]


def _position_sigmas(rows: ObservationRows, _: Members) -> Sigmas:
    """Return sigmas by ephemeris; other ephemerides count as DE421."""
    # Means over a year of DE421, of data until 2007, less DE440 from 1992 to 2050, rms: 0.22 m away from the Earth,
    # 0.03 m normal to the orbit, and along it 0.8 m and a part that grows with the square of time, 1.2 m in 2005 to
    # 2010, 2.8 m in 2019 to 2025. DE440 is tied to the ICRF to 0.2 mas (Park et al. 2021), 0.4 m at the Moon, and by
    # ranges to the reflectors to decimetres. A tilt of the orbit displaces the Moon by a sine of the month, which is
    # part of the variation below.
    if rows.model.ephemeris.name == "DE440":
        return {"": (0.1, 0.4, 0.04)}
    return {"": (0.22, 0.8 + 0.0042 * _years(rows) ** 2, 0.04)}


def _position_variation_sigmas(rows: ObservationRows, _: Members) -> Sigmas:
    """Return the monthly part of DE421 less DE440; half of it for DE440, which has 13 years of data more."""
    # About the mean of some years, rms: away from the Earth 0.03 m until 2008, 0.07 m in 2010 to 2020, 0.14 m in 2020
    # to 2030, 0.29 m in 2030 to 2049; along the orbit 0.1 m besides its trend; normal to it 0.4 m. For DE440 half of
    # the latter and a tilt of 0.2 mas, whose sine has an rms of 0.26 m, are 0.33 m.
    newer = rows.model.ephemeris.name == "DE440"
    half = 0.5 if newer else 1.0
    return {"": (half * (0.03 + 0.00016 * _years(rows) ** 2), half * 0.1, 0.33 if newer else 0.4)}


def _years(rows: ObservationRows) -> float:
    """Return the years from 2000 to the last observation."""
    return (float(rows.observations.epoch.mjd.max()) - _MJD_2000) / _DAYS_PER_YEAR


def _libration_sigmas(rows: ObservationRows, _: Members) -> Sigmas:
    """Return the rms of yearly means of DE421 less DE440 in mean-Earth axes, 1992 to 2050; about half for DE440."""
    newer = rows.model.ephemeris.name == "DE440"
    return {"": (5e-8, 5e-8, 5e-8) if newer else (0.8e-7, 1.4e-7, 0.5e-7)}


def _libration_variation_sigmas(rows: ObservationRows, _: Members) -> Sigmas:
    """Return DE421 less DE440 about its mean 2006 to 2024 (0.07, 0.07, 0.11 m rms on the ground), half for DE440."""
    half = 0.5 if rows.model.ephemeris.name == "DE440" else 1.0
    return {"": (half * 4e-8, half * 4e-8, half * 6e-8)}


MOON_POSITION = ParameterKind(
    name="moon_position",
    unit="m",
    description="correction to the ephemeris' Moon: radial (away from the Earth), along the orbit, normal to it",
    scopes=(Scope.MOON,),
    partials=_moon_position,
    acts_on=all_observations,
    components=("radial", "along", "normal"),
    label="position of the Moon",
    more_partials=True,
    considered=_position_sigmas,
)
LIBRATION = ParameterKind(
    name="libration",
    unit="rad",
    description="correction to the librations: rotation about the principal axes x (to the Earth), y and z (the pole)",
    scopes=(Scope.MOON,),
    partials=_libration,
    acts_on=all_observations,
    components=("x", "y", "z"),
    label="libration of the Moon",
    scale=6e-7,
    considered=_libration_sigmas,
)
# Monthly and annual errors of an ephemeris: constant in a night, uncorrelated between nights.
MOON_POSITION_VARIATION = replace(
    MOON_POSITION,
    name="moon_position_variation",
    label="variation of the Moon's position",
    description="the same of one session, beyond `moon_position`",
    scopes=(Scope.SESSION,),
    considered=_position_variation_sigmas,
)
LIBRATION_VARIATION = replace(
    LIBRATION,
    name="libration_variation",
    label="variation of the libration",
    description="the same of one session, beyond `libration`",
    scopes=(Scope.SESSION,),
    considered=_libration_variation_sigmas,
)
LONGITUDE_LIBRATION = ParameterKind(
    name="longitude_libration",
    unit="rad",
    description="periodic librations in longitude (about z): cosine and sine terms of 365, 206 and 1095 days",
    scopes=(Scope.MOON,),
    partials=_longitude_libration,
    acts_on=all_observations,
    components=tuple(f"{wave}_{period}" for period in _LONGITUDE_TERMS for wave in ("cos", "sin")),
    label="periodic libration in longitude",
    scale=6e-7,
)
LOVE_NUMBERS = ParameterKind(
    name="love_numbers",
    unit="1",
    description="Love numbers h2 and l2 of the Moon beyond the model's",
    scopes=(Scope.MOON,),
    partials=_love_numbers,
    acts_on=all_observations,
    components=("h2", "l2"),
    label="Love number of the Moon",
    scale=0.1,
    more_partials=True,
)
LUNAR_LENGTHS = ParameterKind(
    name="lunar_lengths",
    label="scale of lengths on the Moon",
    unit="1",
    description="scale of lengths on the Moon less one",
    scopes=(Scope.MOON,),
    partials=lambda rows: dot(rows.computed.by_position_pa, rows.target_pa_m)[:, None, None],
    acts_on=all_observations,
    scale=6e-7,
)
