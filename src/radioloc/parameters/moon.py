"""Where the Moon is and how it is turned, its tide and its lengths, each beyond the model's.

The Moon's place acts along the way from the Earth, along its orbit and along the orbit's normal. Errors of place and
librations are constant amounts, and others in each session.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from radioloc.lunar import rot_icrf_to_pa
from radioloc.lunar.tide import solid_tide
from radioloc.parameters import apriori
from radioloc.parameters.kind import ParameterKind, Scope, everywhere
from radioloc.parameters.rows import ObservationRows
from radioloc.time import Epochs
from radioloc.vectors import dot


def _moon_position(rows: ObservationRows) -> NDArray[np.float64]:
    model = rows.model

    def axes_pa(tdb: Epochs) -> NDArray[np.float64]:
        position_m, velocity_m_s = model.ephemeris.geocentric("moon", tdb)
        radial = position_m / np.linalg.norm(position_m, axis=-1)[:, None]
        normal = np.cross(position_m, velocity_m_s)
        normal = normal / np.linalg.norm(normal, axis=-1)[:, None]
        axes = np.stack([radial, np.cross(normal, radial), normal], axis=1)
        to_pa = rot_icrf_to_pa(model.libration.angles(tdb)[0])
        return np.asarray(np.einsum("nij,nkj->nki", to_pa, axes))

    return rows.by_displacement(axes_pa)[:, None, :]


def _libration(rows: ObservationRows) -> NDArray[np.float64]:
    # A rotation by e about an axis moves the target by e x r, so that the partial is r x by_position along the axis.
    return np.cross(rows.target_pa_m, rows.computed.by_position_pa)[:, None, :]


def _love_numbers(rows: ObservationRows) -> NDArray[np.float64]:
    model, positions = rows.model, np.atleast_2d(rows.target_pa_m)
    places, which = np.unique(positions, axis=0, return_inverse=True)
    permanent: Literal["included", "removed"] = "included" if model.has("lunar_tide_constant") else "removed"
    constants = model.ephemeris.constants
    units = [replace(constants, h2=h2, l2=l2) for h2, l2 in ((1.0, 0.0), (0.0, 1.0))]

    def displacements(tdb: Epochs) -> NDArray[np.float64]:
        to_pa = rot_icrf_to_pa(model.libration.angles(tdb)[0])
        moon_m, _ = model.ephemeris.geocentric("moon", tdb)
        sun_m, _ = model.ephemeris.geocentric("sun", tdb)
        earth_pa_m = np.einsum("nij,nj->ni", to_pa, -moon_m)
        sun_pa_m = np.einsum("nij,nj->ni", to_pa, sun_m - moon_m)
        of_places = [
            [solid_tide(place, earth_pa_m, sun_pa_m, unit, permanent) for unit in units] for place in places
        ]
        return np.concatenate([np.array(of_place).swapaxes(0, 1) for of_place in of_places], axis=1)

    columns = rows.by_displacement(displacements).reshape(len(rows), len(places), 2)
    return columns[np.arange(len(rows)), which.reshape(-1)][:, None, :]


MOON_POSITION = ParameterKind(
    name="moon_position",
    unit="m",
    description="correction to the ephemeris' Moon: radial (away from the Earth), along the orbit, normal to it",
    scopes=(Scope.MOON,),
    partials=_moon_position,
    acts_on=everywhere,
    components=("radial", "along", "normal"),
    more_partials=True,
    considered=apriori.moon_position,
)
LIBRATION = ParameterKind(
    name="libration",
    unit="rad",
    description="correction to the librations: rotation about the principal axes x (to the Earth), y and z (the pole)",
    scopes=(Scope.MOON,),
    partials=_libration,
    acts_on=everywhere,
    components=("x", "y", "z"),
    scale=6e-7,
    considered=apriori.libration,
)
# What an ephemeris has wrong in the month and in the year: constant for a night, of no memory from one to the next.
MOON_POSITION_VARIATION = replace(
    MOON_POSITION,
    name="moon_position_variation",
    description="the same of one session, beyond `moon_position`",
    scopes=(Scope.SESSION,),
    considered=apriori.moon_position_variation,
)
LIBRATION_VARIATION = replace(
    LIBRATION,
    name="libration_variation",
    description="the same of one session, beyond `libration`",
    scopes=(Scope.SESSION,),
    considered=apriori.libration_variation,
)
LOVE_NUMBERS = ParameterKind(
    name="love_numbers",
    unit="1",
    description="Love numbers h2 and l2 of the Moon beyond the model's",
    scopes=(Scope.MOON,),
    partials=_love_numbers,
    acts_on=everywhere,
    components=("h2", "l2"),
    scale=0.1,
    more_partials=True,
)
LUNAR_LENGTHS = ParameterKind(
    name="lunar_lengths",
    unit="1",
    description="scale of lengths on the Moon less one",
    scopes=(Scope.MOON,),
    partials=lambda rows: dot(rows.computed.by_position_pa, rows.target_pa_m)[:, None, None],
    acts_on=everywhere,
    scale=6e-7,
)
