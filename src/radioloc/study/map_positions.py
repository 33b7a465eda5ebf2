"""Positions on maps as a-priori positions of targets, from numbers or from a solution of images.

The error of a map's tie to the Moon's axes is common to all positions on the map.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from radioloc.ephemeris.constants import CONSTANTS
from radioloc.errors import InputError, error_context
from radioloc.estimation.combination import PositionEstimate
from radioloc.lunar.local import displaced, local_difference
from radioloc.lunar.position import LunarPosition
from radioloc.measurements.link import Link, canonical_target
from radioloc.results.recorded import read_recorded
from radioloc.study.schema import check, entry
from radioloc.targets.position_prior import PositionPrior, map_tie_names
from radioloc.vectors import Floats

_EITHER = ("longitude_deg", "latitude_deg", "height_m", "sigma_m", "sigma_up_m", "map_sigma_m")
_OPTIONAL = ("height_m", "sigma_up_m")
_METHODS = ("images", "stereo")
_SIGMA_TOLERANCE = 1e-9  # Relative difference of two sigmas that are the same but for rounding


@dataclass(frozen=True, slots=True)
class PlaceOnMap:
    """Position on a map: keys of ``[[observations.map_positions]]``, as the reference of the study file has them."""

    solution: Path | None = None
    longitude_deg: float | None = None
    latitude_deg: float | None = None
    height_m: float | None = None
    sigma_m: tuple[float, float] | None = entry(None, positive=True, both=True)
    sigma_up_m: float | None = entry(None, positive=True)
    map: str | None = None
    map_sigma_m: tuple[float, float] | None = entry(None, positive=True, both=True)
    target: str | None = None
    known_deg_m: tuple[float, float, float] | None = None
    frame: str = "ME_DE421"

    def __post_init__(self) -> None:
        check(self)
        present = [key for key in _EITHER if getattr(self, key) is not None]
        if self.solution is not None and present:
            raise InputError(f"map_positions: {present[0]} is in the solution already; give either of them")
        missing = [key for key in ("map", *_EITHER) if key not in _OPTIONAL and getattr(self, key) is None]
        if self.solution is None and missing:
            raise InputError(f"map_positions: {missing[0]} is missing; give it, or the solution of images")
        if self.sigma_up_m is not None and self.height_m is None:
            raise InputError("map_positions: height_m is missing; sigma_up_m is the sigma of a height")
        self.read()

    @property
    def reference_position(self) -> LunarPosition | None:
        """Known position of a reflector or landmark."""
        if self.known_deg_m is None:
            return None
        return LunarPosition.from_selenographic(*self.known_deg_m, self.frame)

    def read(self) -> MapPosition:
        """Return the position with its covariance and its shared errors."""
        if self.solution is not None:
            position = self._from_solution(self.solution)
        else:
            assert self.longitude_deg is not None
            assert self.latitude_deg is not None
            assert self.sigma_m is not None
            assert self.map_sigma_m is not None
            assert self.map is not None
            place = LunarPosition.from_selenographic(
                self.longitude_deg, self.latitude_deg, self.height_m or 0.0, self.frame
            )
            sigma_up_m = math.nan if self.sigma_up_m is None else self.sigma_up_m
            position = MapPosition(
                self.map,
                _in_mean_earth_axes(place),
                _block(np.diag(np.square([*self.sigma_m, sigma_up_m]))),
                dict(zip(map_tie_names(self.map), np.diag(self.map_sigma_m) @ np.eye(2, 3), strict=True)),
            )
        Link("", self.target or "target", position.map)  # refuses names that no target or map can have
        return position

    def _from_solution(self, path: Path) -> MapPosition:
        content = read_recorded(path)
        stated = {
            item["name"].rpartition(".")[0].partition(".")[2]
            for item in content.get("considered", ())
            if item["name"].startswith("map_tie.")
        }
        if content.get("method") not in _METHODS or len(stated) != 1:
            raise InputError(f"{path}: expected a solution of radioloc images on a map; make it again")
        if not content["converged"]:
            raise InputError(f"{path}: the solution of images did not converge: {content['message']}")
        with error_context(f"{path}:"):
            estimate = PositionEstimate.from_solution(content)
        place = LunarPosition.from_cartesian(estimate.position_me_m, content["position"]["me"]["frame"])
        [on_map] = stated
        name = self.map or on_map
        renamed = dict(zip(map_tie_names(on_map), map_tie_names(name), strict=True))
        errors = {renamed.get(key, key): error_m for key, error_m in estimate.errors_enu_m.items()}
        return MapPosition(name, place, _block(estimate.noise_enu_m2), errors, tuple(sorted(estimate.data)))


@dataclass(frozen=True, slots=True, eq=False)
class MapPosition:
    """Position on a map, mean-Earth axes, with its noise relative to the map and shared errors of one sigma."""

    map: str
    place: LunarPosition
    noise_enu_m2: Floats
    errors_enu_m: Mapping[str, Floats]
    data: tuple[str, ...] = ()


def position_priors(places: Sequence[PlaceOnMap], targets: Sequence[str]) -> tuple[PositionPrior, ...]:
    """Combine positions on maps to one a-priori position of each target."""
    items = [(_target(place, targets), place.reference_position, place.read()) for place in places]
    _require_distinct([position for *_, position in items])
    located = {position.map for _, reference_position, position in items if reference_position is None}
    for _, _, position in items:
        if position.map not in located:
            raise InputError(
                f"expected a target on the map {position.map}, got none; give a known place only beside a target "
                "on the same map"
            )
    return _combined(items) if items else ()


def _target(place: PlaceOnMap, targets: Sequence[str]) -> str:
    """Return the name of a target in the study; empty of known places, and of the only target without a name."""
    if tuple(targets) == ("",) or place.reference_position is not None:
        return ""
    if place.target is None and len(targets) == 1:
        return targets[0]
    name = canonical_target(place.target or "")
    if name not in targets:
        raise InputError(
            f"target: expected one of {', '.join(targets)}, or a known place (known_deg_m), "
            f"got {place.target!r}"
        )
    return name


def _require_distinct(positions: Sequence[MapPosition]) -> None:
    """Require one sigma for each map, and different images."""
    ties: dict[str, float] = {}
    data: set[str] = set()
    for position in positions:
        for name in map_tie_names(position.map):
            tie_m = float(np.linalg.norm(position.errors_enu_m[name]))
            if abs(ties.setdefault(name, tie_m) - tie_m) > _SIGMA_TOLERANCE * tie_m:
                raise InputError(
                    f"the tie {name} has two sigmas, {ties[name]:g} and {tie_m:g} m; give both the same, "
                    "or name two maps"
                )
        if shared := data.intersection(position.data):
            raise InputError(f"two solutions use the same images ({min(shared)}); give one of them")
        data.update(position.data)


def _combined(items: Sequence[tuple[str, LunarPosition | None, MapPosition]]) -> tuple[PositionPrior, ...]:
    """Estimate the positions of all targets by least squares from positions on maps that share errors."""
    origins = {
        target: position.place
        for target, reference_position, position in reversed(items)
        if reference_position is None
    }
    targets = [target for target in dict.fromkeys(target for target, *_ in items) if target in origins]
    blocks = {target: slice(3 * k, 3 * k + 3) for k, target in enumerate(targets)}
    design = np.zeros((3 * len(items), 3 * len(targets)))
    offsets_m = np.zeros(3 * len(items))
    for k, (target, reference_position, position) in enumerate(items):
        rows = slice(3 * k, 3 * k + 3)
        if reference_position is None:
            design[rows, blocks[target]] = np.eye(3)
        offsets_m[rows] = local_difference(
            position.place.xyz_m, (reference_position or origins[target]).xyz_m
        ).enu_m
    gain, total_m2, moved_by_m = _solved(design, [position for *_, position in items])
    moved_m = gain @ offsets_m
    return tuple(
        PositionPrior(
            target,
            LunarPosition.from_cartesian(
                displaced(origins[target].xyz_m, moved_m[block]), origins[target].frame
            ),
            total_m2[block, block],
            {name: effect_m[block] for name, effect_m in moved_by_m.items() if effect_m[block].any()},
            tuple(
                key
                for name, reference_position, position in items
                if name == target or reference_position
                for key in position.data
            ),
            {name: total_m2[block, columns] for name, columns in blocks.items() if name != target},
        )
        for target, block in blocks.items()
    )


def _solved(design: Floats, positions: Sequence[MapPosition]) -> tuple[Floats, Floats, dict[str, Floats]]:
    """Return the gains of weighted least squares, the covariance, and the effects of shared errors by name."""
    from scipy.linalg import block_diag

    names = list(dict.fromkeys(name for position in positions for name in position.errors_enu_m))
    errors_m = np.concatenate(
        [[position.errors_enu_m.get(name, np.zeros(3)) for name in names] for position in positions], axis=1
    ).T
    noise_m2 = block_diag(*(position.noise_enu_m2 for position in positions))
    determined = np.isfinite(np.diag(noise_m2))
    free = np.asarray(design[determined].any(axis=0))
    errors_m[~determined] = 0.0
    covariance_m2 = np.where(np.isfinite(noise_m2), noise_m2, 0.0) + errors_m @ errors_m.T
    design = design[np.ix_(determined, free)]
    weighted = np.linalg.solve(covariance_m2[np.ix_(determined, determined)], design)
    gain = np.zeros((len(free), len(determined)))
    gain[np.ix_(free, determined)] = np.linalg.solve(design.T @ weighted, weighted.T)
    total_m2 = gain @ covariance_m2 @ gain.T
    total_m2[~free], total_m2[:, ~free] = np.nan, np.nan
    return gain, total_m2, dict(zip(names, (gain @ errors_m).T, strict=True))


def _in_mean_earth_axes(place: LunarPosition) -> LunarPosition:
    if place.frame.startswith("ME_"):
        return place
    constants = CONSTANTS.get(place.frame.partition("_")[2])
    return place.to_frame("ME_DE421" if constants is None else constants.me_frame)


def _block(covariance_m2: Floats) -> Floats:
    """Return a covariance with NaN in the row and the column of an undetermined height."""
    determined = np.isfinite(np.diag(covariance_m2))
    return np.where(np.outer(determined, determined), covariance_m2, np.nan)
