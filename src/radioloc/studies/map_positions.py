"""Places where targets are seen on maps, as a study gives them: a solution of images, or numbers."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from radioloc.errors import InputError
from radioloc.estimation.combination import PositionEstimate
from radioloc.lunar.position import LunarPosition
from radioloc.measurements.link import Link
from radioloc.measurements.map_predictor import MapPosition
from radioloc.parameters.moon import MAP_TIE
from radioloc.studies.schema import check, entry
from radioloc.text_files import json_file

_EITHER = ("longitude_deg", "latitude_deg", "height_m", "sigma_m", "map_sigma_m")


@dataclass(frozen=True, slots=True)
class PlaceOnMap:
    """A place that was read on a map, a table ``[[observations.map_positions]]``.

    Parameters
    ----------
    solution : Path or None
        ``solution.json`` of :command:`radioloc images` on a map, or else the numbers that follow.
    longitude_deg, latitude_deg, height_m : float or None
        What the map has there; the height, zero by default, only scales metres.
    sigma_m : float or tuple of float, or None
        Of the place relative to the map, east and north, m.
    map : str or None
        Name of the map; that of the solution's by default.
    map_sigma_m : float or tuple of float, or None
        How well the map is tied to the Moon's axes, east and north, m.
    target : str or None
        What was seen, where there are several targets.
    known_deg_m : tuple of float, or None
        Longitude, latitude and height of what was seen, if that is known: a reflector, whose place tells the tie.
    frame : str
        Axes of the numbers.

    Raises
    ------
    InputError
        Numbers are missing, given beside a solution, or cannot be; the solution is none of images.
    """

    solution: Path | None = None
    longitude_deg: float | None = None
    latitude_deg: float | None = None
    height_m: float | None = None
    sigma_m: tuple[float, float] | None = entry(None, positive=True, both=True)
    map: str | None = None
    map_sigma_m: tuple[float, float] | None = entry(None, positive=True, both=True)
    target: str | None = None
    known_deg_m: tuple[float, float, float] | None = None
    frame: str = "ME_DE421"

    def __post_init__(self) -> None:
        check(self)
        given = [key for key in _EITHER if getattr(self, key) is not None]
        if self.solution is not None and given:
            raise InputError(f"map_positions: {given[0]} is in the solution already; give either of them")
        missing = [key for key in ("map", *_EITHER) if key != "height_m" and getattr(self, key) is None]
        if self.solution is None and missing:
            raise InputError(f"map_positions: {missing[0]} is missing; give it, or the solution of images")
        self.read()

    def read(self) -> MapPosition:
        """The place with its covariance, and the tie of its map."""
        known = (
            None
            if self.known_deg_m is None
            else LunarPosition.from_selenographic(*self.known_deg_m, self.frame)
        )
        if self.solution is None:
            assert self.longitude_deg is not None
            assert self.latitude_deg is not None
            assert self.sigma_m is not None
            assert self.map_sigma_m is not None
            assert self.map is not None
            place = LunarPosition.from_selenographic(
                self.longitude_deg, self.latitude_deg, self.height_m or 0.0, self.frame
            )
            covariance = np.diag(np.square(self.sigma_m))
            found = MapPosition(self.target or "", self.map, place, covariance, self.map_sigma_m, known)
        else:
            found = self._solved(self.solution, known)
        Link("", found.target or "target", found.map, on_map=True)  # knows what can name a target and a map
        return found

    def _solved(self, path: Path, known: LunarPosition | None) -> MapPosition:
        what = "is no solution.json that this version of radioloc images wrote of a place on a map; make it again"
        with json_file(path, what) as content:
            if content["method"] not in ("images", "stereo"):
                raise ValueError
            failed = content["message"]
            me = content["position"]["me"]
            xyz_m, frame = [float(me[f"{axis}_m"]) for axis in "xyz"], me["frame"]
            sigma_m, names = {}, [self.map]
            for item in content["considered"]:
                kind, _, rest = item["name"].partition(".")
                if kind == MAP_TIE.name:
                    name, _, axis = rest.rpartition(".")
                    sigma_m[axis] = float(item["sigma"])
                    names.append(name)
            tie_m, name = (sigma_m["east"], sigma_m["north"]), next(filter(None, names))
            data = tuple(sorted(PositionEstimate.from_solution(content).data))
            total = np.array([row[:2] for row in content["covariance"]["enu_m2"][:2]], dtype=np.float64)
        if failed:
            raise InputError(f"{path}: the solution of images did not converge: {failed}")
        place = LunarPosition.from_cartesian(xyz_m, frame)
        relative = total - np.diag(np.square(tie_m))
        return MapPosition(self.target or "", name, place, relative, tie_m, known, str(path), data)
