"""Predictions of where targets are seen on maps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radioloc.boundary import bare_arguments
from radioloc.errors import InputError
from radioloc.lunar import cartesian_to_selenographic, east_north_up, rot_pa_to_me
from radioloc.lunar.position import LunarPosition
from radioloc.measurements.link import Link, canonical_target
from radioloc.measurements.observations import Observations
from radioloc.measurements.physical_model import PhysicalModel
from radioloc.measurements.predictor import Computed, Predictor
from radioloc.measurements.registry import kind_of


@dataclass(frozen=True, slots=True, eq=False)
class MapPosition:
    """A place that was read on a map.

    Parameters
    ----------
    target : str
        What was seen there; empty for the one target that there is.
    map : str
        Name of the map.
    place : LunarPosition
        Where, in the map's axes.
    covariance_en_m2 : ndarray, shape (2, 2)
        Of east and north relative to the map, m^2.
    map_sigma_m : tuple of float
        How well the map is tied to the Moon's axes, east and north, m; the same error for all that is on the map.
    known : LunarPosition or None
        Where the target truly stands, if that is known: such a place tells the tie of its map.
    origin : str
        The file that it is from.
    data : tuple of str
        What tells the images that it was found in from others.
    """

    target: str
    map: str
    place: LunarPosition
    covariance_en_m2: NDArray[np.float64]
    map_sigma_m: tuple[float, float]
    known: LunarPosition | None = None
    origin: str = "in memory"
    data: tuple[str, ...] = ()


def _named(one: MapPosition, tracked: Sequence[str]) -> MapPosition:
    """With the name of its target, which is among those that are tracked or known otherwise."""
    target = one.target or (tracked[0] if len(tracked) == 1 else "")
    if one.known is not None and one.target:
        return one
    if canonical_target(target) not in map(canonical_target, tracked):
        raise InputError(
            f"[[observations.map_positions]] target: what is seen on {one.map} must be tracked ({', '.join(tracked)}), "
            f"or its place known (known_deg_m), not {target!r}"
        )
    return replace(one, target=target)


class MapPredictor(Predictor):
    """Predicts places on maps, two observations each: east, then north.

    Parameters
    ----------
    beside : Predictor
        Of tracking of the same targets, whose first epoch stands as the time tag.
    positions : sequence of MapPosition

    Raises
    ------
    InputError
        A target is not among those that are tracked, a name cannot be one, or one map has two sigmas.
    """

    def __init__(self, beside: Predictor, positions: Sequence[MapPosition]) -> None:
        self.model, self.trajectory, self.more_partials = beside.model, None, beside.more_partials
        self.targets, self.stations = beside.targets, ()
        self.positions = tuple(positions)
        self.map_sigma_m: dict[str, tuple[float, float]] = {}
        for one in self.positions:
            if self.map_sigma_m.setdefault(one.map, one.map_sigma_m) != one.map_sigma_m:
                raise InputError(
                    f"the map {one.map} has two sigmas of its tie, {self.map_sigma_m[one.map]} and {one.map_sigma_m} m "
                    f"({one.origin}); give both the same, or name two maps"
                )
        self.maps = tuple(self.map_sigma_m)
        links = [beside.observations.links[k] for k in np.unique(beside.observations.link)]
        names = beside.targets or tuple(dict.fromkeys(name for link in links for name in link.targets))
        self.positions = tuple(_named(one, names) for one in self.positions)
        order = [canonical_target(name) for name in beside.targets]
        index = [
            0 if one.known or not order else order.index(canonical_target(one.target))
            for one in self.positions
        ]
        self.target = np.repeat(np.array(index, dtype=np.int32), 2)
        on = [self.maps.index(one.map) for one in self.positions]
        self.transmitters = self.receivers = np.repeat(np.array(on, dtype=np.int32), 2)
        self.observations = self._table(beside.observations)
        self._prepare()

    def _table(self, beside: Observations) -> Observations:
        count = len(self.positions)
        return Observations.from_columns(
            epoch=beside.span()[np.zeros(2 * count, dtype=np.intp)],
            links=[Link("", one.target, one.map, on_map=True) for one in self.positions],
            link=np.repeat(np.arange(count), 2),
            kind=np.tile([kind_of("map_east"), kind_of("map_north")], count),
            value_m=np.zeros(2 * count),
            sigma_m=np.sqrt([np.diag(one.covariance_en_m2) for one in self.positions]).ravel(),
            files=[one.origin for one in self.positions],
            file=np.repeat(np.arange(count), 2),
            line=np.repeat(np.arange(1, count + 1), 2),
        )

    def _prepare(self) -> None:
        """East, north and up at each place and its distance from the Moon's centre, principal axes."""
        constants = self.model.ephemeris.constants
        places_m = np.array([one.place.to_axes("ME", constants).xyz_m for one in self.positions])
        longitude_rad, latitude_rad, _ = cartesian_to_selenographic(places_m)
        self._axes_pa = east_north_up(longitude_rad, latitude_rad) @ rot_pa_to_me(constants)
        self._radius_m = np.linalg.norm(places_m, axis=1)
        self._known_pa_m = np.array(
            [
                np.full(3, np.nan) if one.known is None else one.known.to_axes("PA", constants).xyz_m
                for one in self.positions
            ]
        )

    @property
    def predicted_eop(self) -> NDArray[np.bool_]:
        """Whether an observation rests on predicted Earth orientation, shape (n,): none does."""
        return np.zeros(len(self.observations), dtype=bool)

    @bare_arguments
    def at(self, lander_pa_m: NDArray[np.float64]) -> Computed:
        """Predict for a position: along the great circles of the place's east and north, at its height."""
        known = np.isfinite(self._known_pa_m[:, 0])
        point_m = np.where(known[:, None], self._known_pa_m, np.atleast_2d(lander_pa_m)[self.target[::2]])
        east, north, up = np.einsum("mij,mj->im", self._axes_pa, point_m)
        radius_m, level_m = np.linalg.norm(point_m, axis=1), np.hypot(east, up)
        value_m = self._radius_m * np.array([np.arctan2(east, up), np.arcsin(north / radius_m)])
        e, n, u = np.swapaxes(self._axes_pa, 0, 1)
        by_east = (up[:, None] * e - east[:, None] * u) / level_m[:, None] ** 2
        by_north = (n - (north / radius_m**2)[:, None] * point_m) / level_m[:, None]
        by_position = self._radius_m[:, None, None] * np.stack([by_east, by_north], axis=1)
        by_position[known] = 0.0
        count = len(self.observations)
        nothing = np.zeros(count)
        return Computed(
            value_m=value_m.T.ravel(),
            by_position_pa=by_position.reshape(count, 3),
            by_time_m_s=nothing,
            by_transponder_delay_m_s=nothing,
            by_zenith_wet=np.zeros((count, 2)),
            elevation_rad=np.full((count, 2), np.nan),
            status=np.zeros((count, 2), dtype=np.int8),
            by_station_itrf=np.zeros((count, 0, 3)),
            by_electron_content_m=np.zeros((count, 0)),
            mean_by_position_pa=np.zeros((count, 0)),
            by_orbit=np.zeros((count, 0)),
        )

    def select(self, which: Any) -> MapPredictor:
        """All places: they hold for any arc."""
        return self

    def with_model(self, model: PhysicalModel, lander_pa_m: NDArray[np.float64]) -> MapPredictor:
        """The same: no term of the model is in it."""
        return self
