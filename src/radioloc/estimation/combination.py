"""Comparison of positions: with a reference, of several estimates, and the joint estimate."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from radioloc.errors import InputError
from radioloc.estimation.shared_observations import SampledSeries, share_observations
from radioloc.estimation.statistics import finite_or_none
from radioloc.lunar.local import LocalDifference, axes_at, displaced, local_difference, rot_enu_between
from radioloc.time import epochs_from_strings, utc_to_tai
from radioloc.vectors import Floats

_AXES = ("east", "north", "up")
_NUMBER = re.compile(r"[ .]\d+(?=\.|$)")
_ABOVE_TERRAIN = "height_above_terrain"
_MIN_OWN_FRACTION = 1e-6  # of the variances, for a test: below, both heights are the same a-priori value
_MAX_ITERATIONS = 20
_STEP_TOLERANCE_M = 1e-5


@dataclass(frozen=True, slots=True, kw_only=True)
class ReferenceComparison(LocalDifference):
    """The estimate less a known position."""

    name: str  #: reference of the comparison
    #: Where that is: east longitude and latitude in mean-Earth axes, deg, height above the 1737.4 km sphere, m.
    longitude_deg: float
    latitude_deg: float  #: likewise
    height_m: float  #: likewise
    east_sigmas: float | None  #: the same in total standard deviations; None where that is zero or infinite
    north_sigmas: float | None  #: likewise
    up_sigmas: float | None  #: likewise
    #: Length of the difference in standard deviations, correlations considered (Mahalanobis distance); below
    #: 2.80 in 95 % of cases if both positions are right. None where the covariance has no inverse.
    combined_sigmas: float | None

    def to_dict(self) -> dict[str, Any]:
        """Return the fields and both distances for JSON."""
        return asdict(self) | {"horizontal_m": self.horizontal_m, "distance_m": self.distance_m}


@dataclass(frozen=True, slots=True)
class Ellipse:
    """An error ellipse in the horizontal plane."""

    semi_major_m: float  #: semi-axes, m
    semi_minor_m: float  #: likewise
    azimuth_deg: float  #: direction of the major axis from north over east, 0 to 180 deg


def horizontal_ellipse(covariance_en_m2: Floats, probability: float = 0.95) -> Ellipse:
    """Error ellipse of a covariance of east and north, m^2, which holds the true point with a probability."""
    # For two dimensions the factor to the one-sigma axes is sqrt(-2 ln(1 - probability)), 2.45 for 95 %.
    variances, vectors = np.linalg.eigh(covariance_en_m2)
    factor = math.sqrt(-2.0 * math.log(1.0 - probability))
    minor, major = factor * np.sqrt(np.maximum(variances, 0.0))
    azimuth_deg = math.degrees(math.atan2(vectors[0, 1], vectors[1, 1])) % 180.0
    return Ellipse(float(major), float(minor), azimuth_deg)


@dataclass(frozen=True, slots=True)
class TerrainHeight:
    """A-priori height of a terrain model, whose own error is common to all places and whose roughness is local."""

    name: str  # of the a-priori value
    common_part: float  # of its variance, the error of the model
    resolution_m: float  # distance over which the rest decays

    def correlation(self, distance_m: float) -> float:
        """Correlation of the errors at two places."""
        return self.common_part + (1.0 - self.common_part) * math.exp(-distance_m / self.resolution_m)


@dataclass(frozen=True, slots=True, eq=False)
class PositionEstimate:
    """Estimate of a position as its solution states it, in mean-Earth axes."""

    name: str
    position_me_m: Floats  # (3,)
    noise_enu_m2: Floats  # (3, 3), without considered errors; NaN where a component is not determined
    # Changes of the position (3,) by one sigma of each considered error, and of each a-priori value that the noise
    # has in it. The same name in two estimates is the same error or the same information.
    errors_enu_m: Mapping[str, Floats]
    priors_enu_m: Mapping[str, Floats] = field(default_factory=dict)
    spans_utc: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    in_weights: frozenset[str] = frozenset()  # those of the errors that the estimate is weighed by
    terrain: TerrainHeight | None = None
    data: frozenset[str] = frozenset()  # hashes or names of its files
    images: frozenset[str] = frozenset()  # those of them that are images
    observations: tuple[SampledSeries, ...] | None = None  # a sample
    study: str | None = None  # hash; estimates of one study differ in the hours of data only
    hours: float = math.inf  # infinite for all of the data
    # Whether the covariance holds along straight lines, as of tracking alone; else along the sphere and in height.
    straight: bool = False

    @classmethod
    def from_solution(cls, content: Mapping[str, Any]) -> PositionEstimate:
        """Read the estimate of ``solution.json``; :class:`InputError` for a target without a position."""
        if not content["position"]:
            raise InputError(
                f"{content['name']}: expected a position, got a target on a trajectory; estimated orbits are in the "
                "files orbit.bsp, orbit.oem and orbit.opm of locate --out"
            )
        provenance = content["provenance"]
        study = provenance.get("study") or {}
        errors = {item["name"]: np.array(item["position_enu_m"]) for item in content.get("considered", ())}
        # An estimate follows an a-priori value, and goes against the error of a considered one.
        rows = {_prior_name(item, provenance): item for item in content.get("priors", ())}
        priors = {name: -np.array(item["position_enu_m"]) for name, item in rows.items()}
        timed = {item["name"]: item for item in content.get("considered", ())} | rows
        sample = content.get("observations")
        images = frozenset(provenance.get("images", ()))
        sigmas = content["sigma"].get("ephemeris", {}).values()
        for axis, name, sigma_m in zip(np.eye(3), _AXES, sigmas, strict=False):
            errors[f"ephemeris.{name}"] = axis * sigma_m
        total = np.array(content["covariance"]["enu_m2"], dtype=np.float64)
        files = provenance.get("files", ())
        input_files = {
            item["sha256"] or item["file"] for item in study.get("inputs", ()) if item["file"] in files
        }
        return cls(
            content["name"],
            np.array([content["position"]["me"][f"{axis}_m"] for axis in "xyz"]),
            total - _squares(errors),
            errors,
            priors,
            {
                name: (item["first_utc"], item["last_utc"])
                for name, item in timed.items()
                if "first_utc" in item
            },
            frozenset(item["name"] for item in content.get("considered", ()) if item.get("in_weights")),
            _terrain_height(rows, provenance),
            frozenset(input_files or files) | images,
            images,
            None if sample is None else tuple(map(SampledSeries.from_dict, sample)),
            study.get("sha256"),
            math.inf if study.get("hours") is None else study["hours"],
            sample is not None
            and not any(item["name"].startswith("position.") for item in rows.values())
            and bool(np.isfinite(total).all()),
        )

    @property
    def total_enu_m2(self) -> Floats:
        """Covariance with considered errors, shape (3, 3)."""
        return self.noise_enu_m2 + _squares(self.errors_enu_m)

    def carried_to(self, origin_m: Floats) -> PositionEstimate:
        """Return the estimate with its covariance in the east, north and up of another point, mean-Earth axes, m."""
        rotation = rot_enu_between(self.position_me_m, origin_m)
        return self._rotated(rotation, rotated_covariance(rotation, self.noise_enu_m2))

    def offset_from(self, origin_m: Floats) -> tuple[Floats, PositionEstimate]:
        """Return the offset from a point, east, north, up there, m, shape (3,), and the estimate in these axes."""
        if not self.straight:
            return local_difference(self.position_me_m, origin_m).enu_m, self.carried_to(origin_m)
        axes = axes_at(origin_m)
        rotation = axes @ axes_at(self.position_me_m).T
        rotated = self._rotated(rotation, rotation @ self.noise_enu_m2 @ rotation.T)
        return axes @ (self.position_me_m - origin_m), rotated

    def _rotated(self, rotation: Floats, noise_enu_m2: Floats) -> PositionEstimate:
        return replace(
            self,
            noise_enu_m2=noise_enu_m2,
            errors_enu_m={name: rotation @ moved_m for name, moved_m in self.errors_enu_m.items()},
            priors_enu_m={name: rotation @ moved_m for name, moved_m in self.priors_enu_m.items()},
        )

    def shares_data(self, other: PositionEstimate) -> bool:
        """Return whether two estimates have observations or images in common."""
        if self.observations is None or other.observations is None:
            return bool(self.data & other.data)
        return bool(self.images & other.images) or share_observations(self.observations, other.observations)

    def common_covariance(self, other: PositionEstimate) -> Floats:
        """Covariance of the errors of two estimates in the same axes that have no data in common, shape (3, 3)."""
        covariance = np.zeros((3, 3))
        names_of_other: dict[str, list[str]] = {}
        for name in (*other.errors_enu_m, *other.priors_enu_m):
            names_of_other.setdefault(_without_number(name, other.spans_utc), []).append(name)
        for name, moved_m in (*self.errors_enu_m.items(), *self.priors_enu_m.items()):
            for other_name in names_of_other.get(_without_number(name, self.spans_utc), ()):
                other_effects = other.errors_enu_m if other_name in other.errors_enu_m else other.priors_enu_m
                covariance += self._part_in_common(name, other, other_name) * np.outer(
                    moved_m, other_effects[other_name]
                )
        return covariance

    def _part_in_common(self, name: str, other: PositionEstimate, other_name: str) -> float:
        """Correlation of an error with one of another estimate."""
        if self.terrain is not None and name == self.terrain.name:
            return self.terrain.correlation(float(np.linalg.norm(self.position_me_m - other.position_me_m)))
        if name not in self.spans_utc or other_name not in other.spans_utc:
            return 1.0
        return _overlap(self.spans_utc[name], other.spans_utc[other_name])

    def contains(self, other: PositionEstimate) -> bool:
        """Return whether the data of another estimate of the study are a part of the data."""
        return self.study is not None and self.study == other.study and self.hours > other.hours


def _terrain_height(rows: Mapping[str, Any], provenance: Mapping[str, Any]) -> TerrainHeight | None:
    """Return the a-priori height above terrain among the a-priori values of a solution."""
    for name, item in rows.items():
        if item["name"].endswith(_ABOVE_TERRAIN):
            model = provenance["estimate"]["height_prior"]
            part = min(float(model["sigma_m"]) / float(item["sigma"]), 1.0) ** 2
            return TerrainHeight(name, part, float(provenance["terrain_resolution_m"]))
    return None


@dataclass(frozen=True, slots=True)
class Agreement:
    """Difference of two estimates with its significance."""

    one: str
    two: str
    difference_enu_m: tuple[float, float, float]  # the first less the second
    sigma_enu_m: tuple[float | None, ...] | None = None  # None where there is no test, or no such component
    components: int = 0  # of east, north, up that both determine: degrees of freedom
    chi2: float | None = None  # None where there is no test
    why: str = ""  # reason for the lack of a test

    @property
    def chance(self) -> float | None:
        """Probability of a difference at least as unlikely, if both estimates and their sigmas are right."""
        return None if self.chi2 is None else _chance(self.chi2, self.components)


@dataclass(frozen=True, slots=True, eq=False)
class JointEstimate:
    """Joint estimate of a position from several solutions."""

    position_me_m: Floats  # (3,)
    covariance_enu_m2: Floats  # (3, 3), total
    names: tuple[str, ...]  # of the estimates that it rests on
    left_out: Mapping[str, str] = field(default_factory=dict)  # the others, and why
    chi2: float = 0.0  # of their differences from it
    dof: int = 0

    @property
    def chance(self) -> float | None:
        """Probability of differences at least as large, if all are right."""
        return _chance(self.chi2, self.dof) if self.dof else None


def agreement(first: PositionEstimate, second: PositionEstimate, *, horizontal: bool = False) -> Agreement:
    """Compare two estimates by the covariance that their difference should have.

    Estimates from different data are independent but for errors and a-priori values of the same name. An estimate from
    all data is uncorrelated with what a part of them differs from it: the difference has the covariance of the part
    less that of the whole (Hausman 1978), in which errors are that both are weighed by, and what the other errors move
    the one otherwise than the other.
    """
    difference_m = local_difference(first.position_me_m, second.position_me_m).enu_m
    result = Agreement(first.name, second.name, tuple(difference_m.tolist()))
    first, has_own_data = first.carried_to(second.position_me_m), np.ones(3, dtype=bool)
    if first.contains(second) or second.contains(first):
        part, total = (second, first) if first.contains(second) else (first, second)
        covariance = part.noise_enu_m2 - total.noise_enu_m2
        for name in dict.fromkeys([*first.errors_enu_m, *second.errors_enu_m]):
            of_part, of_whole = (estimate.errors_enu_m.get(name, np.zeros(3)) for estimate in (part, total))
            if name in part.in_weights | total.in_weights:
                covariance = covariance + np.outer(of_part, of_part) - np.outer(of_whole, of_whole)
            else:
                covariance = covariance + np.outer(of_part - of_whole, of_part - of_whole)
    elif first.shares_data(second):
        return replace(result, why="they share observations")
    else:
        common = first.common_covariance(second)
        sum_m2 = first.total_enu_m2 + second.total_enu_m2
        covariance = sum_m2 - common - common.T
        has_own_data = np.diag(covariance) > _MIN_OWN_FRACTION * np.diag(sum_m2)
    components = np.flatnonzero(
        np.isfinite(np.diag(covariance)) & [True, True, not horizontal] & has_own_data
    )
    tested = covariance[np.ix_(components, components)]
    if not components.size:
        return replace(result, why="the sigmas of one are not known")
    if not (np.linalg.eigvalsh(tested) > 0.0).all():
        return replace(result, why="one is stated to know as much from a part as the other from the whole")
    # Of a height that is not tested, a part may be stated to know as much as the whole.
    sigmas = tuple(
        None if variance < 0.0 else finite_or_none(math.sqrt(variance)) for variance in np.diag(covariance)
    )
    statistic = float(difference_m[components] @ np.linalg.solve(tested, difference_m[components]))
    return replace(result, sigma_enu_m=sigmas, components=components.size, chi2=statistic)


def joint_estimate(estimates: Sequence[PositionEstimate]) -> JointEstimate | None:
    """Combine estimates by least squares with their common errors; None where fewer than two have data of their own."""
    order = sorted(estimates, key=lambda item: float(np.trace(item.total_enu_m2[:2, :2])))
    used: list[PositionEstimate] = []
    left_out: dict[str, str] = {}
    for item in order:
        if not np.isfinite(np.diag(item.noise_enu_m2)[:2]).all():
            left_out[item.name] = "its sigmas are not known"
        elif shared := [other.name for other in used if other.shares_data(item)]:
            left_out[item.name] = f"it shares observations with {shared[0]}"
        else:
            used.append(item)
    if len(used) < 2:
        return None
    origin_m = used[0].position_me_m
    # Directions and heights differ from one point to another, so offsets are taken anew at the estimate.
    for _ in range(_MAX_ITERATIONS):
        offsets_m, shifted = zip(*(item.offset_from(origin_m) for item in used), strict=True)
        total = np.block(
            [
                [one.total_enu_m2 if one is two else one.common_covariance(two) for two in shifted]
                for one in shifted
            ]
        )
        finite = np.isfinite(np.diag(total))
        design = np.tile(np.eye(3), (len(used), 1))[finite]
        # A covariance that both take from one a-priori value alone could not be factorized.
        total += np.diag(1e-9 * np.diag(total))
        root = np.linalg.cholesky(total[np.ix_(finite, finite)])
        whitened = np.linalg.solve(root, design)
        observed = np.linalg.solve(root, np.concatenate(offsets_m)[finite])
        inverse = np.linalg.pinv(whitened.T @ whitened)
        step_m = inverse @ whitened.T @ observed
        misfit = observed - whitened @ step_m
        previous_m, origin_m = origin_m, displaced(origin_m, step_m)
        if np.linalg.norm(step_m) < _STEP_TOLERANCE_M:
            break
    determined = np.asarray(design.any(axis=0))
    covariance = np.where(np.outer(determined, determined), inverse, np.nan)
    return JointEstimate(
        origin_m,
        rotated_covariance(rot_enu_between(previous_m, origin_m), covariance),
        tuple(item.name for item in used),
        left_out,
        float(misfit @ misfit),
        len(observed) - int(determined.sum()),
    )


def _chance(statistic: float, dof: int) -> float:
    from scipy.special import chdtrc

    return float(chdtrc(dof, statistic))


def _overlap(first_utc: tuple[str, str], second_utc: tuple[str, str]) -> float:
    """Correlation of the means of white noise over two spans of time."""
    ends = utc_to_tai(epochs_from_strings([*first_utc, *second_utc], "UTC"))
    ends_s = ends.seconds_since(ends[[0, 0, 0, 0]]).reshape(2, 2).tolist()
    (first, last), (other_first, other_last) = ((start, max(end, start + 1.0)) for start, end in ends_s)
    common_s = min(last, other_last) - max(first, other_first)
    return max(common_s, 0.0) / math.sqrt((last - first) * (other_last - other_first))


def _without_number(name: str, spans_utc: Mapping[str, Any]) -> str:
    """Name of an error of some time without the number that it has in its arc."""
    return _NUMBER.sub("", name, count=1) if name in spans_utc else name


def _prior_name(item: Mapping[str, Any], provenance: Mapping[str, Any]) -> str:
    """Name of an a-priori value, which is another one with another value or from another source."""
    words = [item["name"]]
    component = item["name"].rpartition(".")[2]
    if component == _ABOVE_TERRAIN:
        words += sorted(file["sha256"] for file in provenance["estimate"]["height_prior"]["dem"])
    elif component in ("east", "north"):
        words.append(json.dumps(provenance.get("a_priori")))  # zero is where that is
    if item["value"]:
        words.append(repr(item["value"]))
    return " ".join(words)


def rotated_covariance(rotation: Floats, covariance_m2: Floats) -> Floats:
    """Return a covariance of east, north and up after a rotation about up; NaN stays where it is."""
    horizontal = rotation[:2, :2]
    rotated = covariance_m2.copy()
    rotated[:2, :2] = horizontal @ covariance_m2[:2, :2] @ horizontal.T
    rotated[:2, 2] = horizontal @ covariance_m2[:2, 2]
    rotated[2, :2] = covariance_m2[2, :2] @ horizontal.T
    return rotated


def _squares(errors_enu_m: Mapping[str, Floats]) -> Floats:
    return sum((np.outer(moved, moved) for moved in errors_enu_m.values()), np.zeros((3, 3)))
