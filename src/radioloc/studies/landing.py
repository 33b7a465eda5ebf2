"""A target that lands: an orbiter until its touchdown, a point fixed to the Moon from then on."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from radioloc.boundary import bare_fields
from radioloc.constants import MEAN_LUNAR_RADIUS_M
from radioloc.dynamics import AdjustableOrbit, Forces
from radioloc.errors import InputError
from radioloc.lunar.position import LunarPosition
from radioloc.measurements.physical_model import PhysicalModel
from radioloc.parameters.landing import Ground
from radioloc.time import Epochs, utc_strings

Floats = NDArray[np.float64]

_LOWEST_M, _HIGHEST_M = -20e3, 25e3
"""Heights at which a-priori trajectories may end: those of the ground, give or take what the thrust may be wrong."""
_FARTHEST_M = 200e3


@dataclass(frozen=True, slots=True, eq=False)
class Landing:
    """When a spacecraft comes to rest on the Moon, and where.

    Parameters
    ----------
    epoch : Epochs
        Of the touchdown, TDB, one.
    place : LunarPosition, optional
        The a-priori place; where the a-priori trajectory ends, if not given.
    """

    epoch: Epochs
    place: LunarPosition | None = None

    def __post_init__(self) -> None:
        bare_fields(self)
        self.epoch.require("TDB")
        if len(self.epoch) != 1:
            raise InputError(f"epoch of the landing must be one, not {len(self.epoch)}")

    def __str__(self) -> str:
        return f"touchdown at {utc_strings(self.epoch, 3)[0]} TDB"

    def place_pa_m(self, model: PhysicalModel) -> Floats | None:
        """The a-priori place in principal axes, m, if it is given."""
        return None if self.place is None else self.place.to_axes("PA", model.ephemeris.constants).xyz_m

    def forces(self, given: Forces, epoch: Epochs, state: Floats) -> Forces:
        """Forces whose radial, transverse and normal axes keep to the plane of the a-priori orbit.

        The orbit's own turns and vanishes as the velocity does.
        """
        for one in given.accelerations:
            for moment in (one.start, one.stop):
                if moment is not None and not (
                    moment.seconds_since(epoch)[0] >= 0.0 and self.epoch.seconds_since(moment)[0] >= 0.0
                ):
                    raise InputError(
                        f"acceleration {one.name} starts or stops at {utc_strings(moment, 3)[0]} TDB, which is not "
                        f"between the epoch of the state, {utc_strings(epoch, 3)[0]}, and the {self}; correct its "
                        "times"
                    )
        normal = np.cross(state[:3], state[3:])
        x, y, z = (normal / np.linalg.norm(normal)).tolist()
        return replace(
            given, accelerations=tuple(replace(one, normal=(x, y, z)) for one in given.accelerations)
        )

    def at_rest(self, flight: AdjustableOrbit, model: PhysicalModel) -> AdjustableOrbit:
        """The orbit that comes to rest at the a-priori place."""
        ground, place_pa_m = Ground(model, self.epoch), self.place_pa_m(model)
        if place_pa_m is None:
            place_pa_m = ground.place_pa_m(self.landed(flight, model).state)
        return flight.moved_to(self.epoch, ground.at_rest(place_pa_m))

    def landed(self, flight: AdjustableOrbit, model: PhysicalModel) -> AdjustableOrbit:
        """The orbit of an a-priori state, with its end as the state; an InputError where that is not at the ground."""
        landed = flight.moved_to(self.epoch)
        end_pa_m = Ground(model, self.epoch).place_pa_m(landed.state)
        height_m, place_pa_m = float(np.linalg.norm(end_pa_m)) - MEAN_LUNAR_RADIUS_M, self.place_pa_m(model)
        off = ""
        if not _LOWEST_M < height_m < _HIGHEST_M:
            off = f"{height_m / 1e3:.1f} km above the sphere of 1737.4 km"
        elif (
            place_pa_m is not None and (away_m := float(np.linalg.norm(end_pa_m - place_pa_m))) > _FARTHEST_M
        ):
            off = f"{away_m / 1e3:.0f} km from the a-priori place"
        if off:
            raise InputError(
                f"the a-priori trajectory of {flight.name} is {off} at the {self}; correct its state, the "
                "accelerations or the epoch of [target.landing]"
            )
        return landed
