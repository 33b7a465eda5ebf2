"""Base map from overlapping orbital images: joint adjustment, orthophotos and a seamless mosaic."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import combinations, compress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radioloc.errors import InputError, in_file
from radioloc.imaging.mosaic import write_mosaic
from radioloc.imaging.orthophoto import write_orthophoto
from radioloc.imaging.point_location import build_provenance, mean_earth_support
from radioloc.imaging.sensor_models import SensorModel
from radioloc.imaging.strip_adjustment import (
    GroundTies,
    StripAdjustment,
    adjust_strips,
    agreement_m,
    ground_partials,
    pixel_size_m,
    require_connected,
)
from radioloc.imaging.strip_ties import find_ground_ties
from radioloc.imaging.study import BaseMapChoice, PointStudy, read_image_study
from radioloc.imaging.surfaces import Terrain
from radioloc.lunar import TerrainModel, cartesian_to_selenographic, selenographic_to_cartesian
from radioloc.lunar.grey_images import open_grey
from radioloc.lunar.local import axes_at
from radioloc.progress import progress_bar
from radioloc.report.files import made_folder
from radioloc.results.cards import Card, Field, metres, provenance_detail
from radioloc.results.result import Content, Result, Table
from radioloc.vectors import Floats

MOSAIC, ORTHOPHOTOS = "mosaic.tif", "orthophotos"
_SEARCH_SIGMAS = 3.0  # of the difference of places in two images
_TIE_ROUNDS = 2
_CORRECTIONS = tuple(
    f"{axis}{kind}"
    for kind in ("", "_drift")
    for axis in ("east_m", "north_m", "up_m", "x_rad", "y_rad", "z_rad")
)


@dataclass(frozen=True, slots=True, eq=False)
class BaseMap(Result):
    """Base map from orbital images.

    Parameters
    ----------
    name : str
    images : tuple of str
        Names of the images.
    mosaic : Path
        GeoTIFF of the mosaic.
    ties : GroundTies
        Tie points of the images.
    adjustment : StripAdjustment
        Corrected sensor models with the covariance of all corrections.
    sigma_m : ndarray, shape (images, 2)
        Standard deviations east and north of the ground in the middle of each image, m.
    seam_steps : mapping
        Relative step of brightness across the seam of a pair of images.
    rejected : tuple of str
        Ground points that do not agree with the images.
    provenance : mapping
    """

    name: str
    images: tuple[str, ...]
    mosaic: Path
    ties: GroundTies = field(repr=False)
    adjustment: StripAdjustment = field(repr=False)
    sigma_m: Floats = field(repr=False)
    seam_steps: Mapping[tuple[int, int], float] = field(repr=False)
    rejected: tuple[str, ...] = ()
    provenance: Mapping[str, Any] = field(default_factory=dict, repr=False)

    @property
    def consistent(self) -> bool:
        """True if all ground points agree with the images."""
        return not self.rejected

    @property
    def map_sigma_m(self) -> tuple[float, float]:
        """Standard deviations east and north of the map, m: the root mean square over the images."""
        east, north = np.sqrt(np.mean(self.sigma_m**2, axis=0)).tolist()
        return east, north

    def to_dict(self) -> dict[str, Any]:
        """Return all numbers in types that JSON has."""
        result = self.adjustment
        return {
            "name": self.name,
            "method": "base_map",
            "status": "consistent" if self.consistent else "ground points disagree",
            "rejected_ground_points": list(self.rejected),
            "mosaic": self.mosaic.name,
            "base_map_sigma_m": list(self.map_sigma_m),
            "tie_points": {
                "number": len(result.used),
                "rejected": int((~result.used).sum()),
                "sigma_factor": result.sigma_factor,
                "redundancy": result.redundancy,
            },
            "images": [
                {
                    "file": name,
                    "corrections": dict(zip(_CORRECTIONS, correction, strict=True)),
                    "sigmas": dict(zip(_CORRECTIONS, sigmas, strict=True)),
                    "ground_sigma_m": ground,
                }
                for name, correction, sigmas, ground in zip(
                    self.images,
                    result.corrections.tolist(),
                    np.sqrt(np.diag(result.covariance)).reshape(-1, len(_CORRECTIONS)).tolist(),
                    self.sigma_m.tolist(),
                    strict=True,
                )
            ],
            "pairs": [
                {
                    "images": [self.images[i], self.images[j]],
                    "tie_points": int(count),
                    "east_m": east_m,
                    "north_m": north_m,
                    "seam_step": self.seam_steps.get((i, j)),
                }
                for (i, j), (east_m, north_m, count) in sorted(agreement_m(self.ties, result).items())
            ],
            "provenance": dict(self.provenance),
        }

    def files(self) -> Mapping[str, Content]:
        """Return ``base_map.json`` and ``tie_points.csv``."""
        ties, result = self.ties, self.adjustment
        longitude, latitude, height_m = cartesian_to_selenographic(result.ground_m)
        columns = {
            "point": ties.point,
            "image": [self.images[k] for k in ties.image],
            "sample_px": ties.pixels[:, 0],
            "line_px": ties.pixels[:, 1],
            "longitude_deg": np.degrees(longitude),
            "latitude_deg": np.degrees(latitude),
            "height_m": height_m,
            "residual_east_m": result.residuals_m[:, 0],
            "residual_north_m": result.residuals_m[:, 1],
            "used": result.used[ties.point].astype(int),
        }
        decimals = {"longitude_deg": 7, "latitude_deg": 7} | dict.fromkeys(
            ("sample_px", "line_px", "height_m", "residual_east_m", "residual_north_m"), 3
        )
        return {"base_map.json": self.to_dict(), "tie_points.csv": Table(columns, decimals)}

    def card(self) -> Card:
        """Return the card of the base map."""
        content = self.to_dict()
        east, north = self.map_sigma_m
        tie = content["tie_points"]
        status = "CONSISTENT" if self.consistent else f"NOT CONSISTENT: {', '.join(self.rejected)}"
        rows = [
            (
                image["file"],
                *(metres(value) for value in list(image["corrections"].values())[:3]),
                *(metres(value) for value in image["ground_sigma_m"]),
            )
            for image in content["images"]
        ]
        differences = [math.hypot(pair["east_m"], pair["north_m"]) for pair in content["pairs"]]
        steps = [abs(step) for step in self.seam_steps.values()]
        agreement = (
            f"{tie['number'] - tie['rejected']} of {tie['number']} tie points used, sigma factor "
            f"{tie['sigma_factor']:.2f}",
            f"largest mean difference of two images {metres(max(differences, default=0.0))} m",
            f"largest step of brightness across a seam {100.0 * max(steps, default=0.0):.2f} %",
        )
        heading = ("image", "east, m", "north, m", "up, m", "sigma east, m", "sigma north, m")
        return Card(
            (
                Field("base map", (self.name,)),
                Field("status", (status,)),
                Field("1 sigma", (f"base_map_sigma_m = [{east:.1f}, {north:.1f}]  # east, north",)),
                Field("agreement", agreement),
                Field("corrections", (), heading, rows),
            ),
            (provenance_detail(self.provenance),),
        )


def make_base_map(study: PointStudy | str | Path, folder: str | Path, *, progress: bool = False) -> BaseMap:
    """Adjust orbital images together, and write their orthophotos and a seamless mosaic.

    Parameters
    ----------
    study : PointStudy or path-like
        From :func:`~radioloc.imaging.read_image_study` of a file with ``[base_map]``, or its path.
    folder : path-like
        Folder for ``mosaic.tif`` and ``orthophotos/NAME.tif``, created if necessary.
    progress : bool
        Whether a progress bar is shown, on a terminal or in a notebook.

    Returns
    -------
    BaseMap
        Corrections of the images with their covariance, and the sigma of the map.

    Raises
    ------
    InputError
        A file cannot be used, an image has no tie points, or the elevation model does not cover the images.
    ConvergenceError
        The adjustment does not converge.

    Examples
    --------
    >>> from radioloc.imaging import make_base_map
    >>> make_base_map("strips.toml", "out").map_sigma_m  # doctest: +SKIP
    (12.1, 11.8)
    """
    if not isinstance(study, PointStudy):
        study = read_image_study(study)  # type: ignore[assignment]
    if not isinstance(study, PointStudy) or not isinstance(study.chosen, BaseMapChoice):
        raise InputError("expected a study with [base_map]; radioloc images runs the other tables")
    chosen = study.chosen
    folder = made_folder(folder)
    orthophotos = made_folder(folder / ORTHOPHOTOS)
    terrain = TerrainModel.open(chosen.dem)
    files = chosen.models or chosen.images
    models = tuple(mean_earth_support(path).model for path in files)
    for path, model in zip(files, models, strict=True):
        with in_file(path):  # fails early where the elevation model does not cover an image
            pixel_size_m(model, 0.5 * np.array(model.shape[::-1], dtype=np.float64), Terrain(terrain))
    sigmas = np.concatenate(
        [
            chosen.position_sigma_m,
            chosen.attitude_sigma_rad,
            chosen.position_drift_m,
            chosen.attitude_drift_rad,
        ]
    )
    write = partial(_write_orthophotos, chosen, terrain, progress)
    ties, names = _with_ground_points(_no_ties(), chosen)
    result = adjust_strips(models, ties, Terrain(terrain), sigmas, chosen.dem_sigma_m)
    # Orthophotos of the adjusted models show relief in the same place: their tie points are free of its effect.
    for _ in range(_TIE_ROUNDS if len(models) > 1 else 0):
        with TemporaryDirectory(prefix="radioloc-") as scratch:
            radius_m = _search_radius_m(result, Terrain(terrain))
            matched = find_ground_ties(write(result.models, Path(scratch)), result.models, terrain, radius_m)
        require_connected(matched, [path.name for path in chosen.images])
        ties, names = _with_ground_points(matched, chosen)
        result = adjust_strips(models, ties, Terrain(terrain), sigmas, chosen.dem_sigma_m)
    written = write(result.models, orthophotos)
    steps = write_mosaic(folder / MOSAIC, written)
    sigma = [
        np.sqrt(np.square(height * chosen.dem_sigma_m) + np.diag(by_all @ result.covariance @ by_all.T))
        for by_all, height in _middle_partials(result, Terrain(terrain))
    ]
    rejected = tuple(compress(names, ~result.used[len(result.used) - len(names) :]))
    return BaseMap(
        study.name,
        tuple(path.name for path in chosen.images),
        folder / MOSAIC,
        ties,
        result,
        np.array(sigma),
        steps,
        rejected,
        build_provenance(study.path, chosen.images, (*chosen.models, chosen.dem)),
    )


def _write_orthophotos(
    chosen: BaseMapChoice, terrain: TerrainModel, progress: bool, models: Sequence[SensorModel], folder: Path
) -> list[Path]:
    """Write the orthophoto of each image, of which one at a time is in memory."""
    written = []
    for path, model in progress_bar([*zip(chosen.images, models, strict=True)], shown=progress, unit="image"):
        written.append(folder / f"{path.stem}.tif")
        image = [(_pixels(path), model)]
        write_orthophoto(
            written[-1], image, terrain, projection=chosen.projection, resolution_m=chosen.resolution_m
        )
    return written


def _pixels(path: Path) -> NDArray[Any]:
    """Read an image; invalid pixels of numbers with a fraction are NaN, of others 0."""
    with open_grey(path) as dataset:
        band = dataset.read(1, masked=True)
    return np.asarray(band.filled(np.nan if band.dtype.kind == "f" else 0))


def _no_ties() -> GroundTies:
    empty = np.zeros(0, np.int64)
    return GroundTies(empty, empty, np.zeros((0, 2)), np.zeros(0), np.zeros((0, 3)), np.zeros(0))


def _with_ground_points(ties: GroundTies, chosen: BaseMapChoice) -> tuple[GroundTies, list[str]]:
    """Return the tie points followed by the ground points, and the names of these."""
    points = chosen.ground_points
    if not points:
        return ties, []
    by_name = {point.name: point for point in points}
    names, stated = list(by_name), by_name.values()
    images = [[path.name for path in chosen.images].index(point.image) for point in points]
    longitude, latitude = np.radians([(point.longitude_deg, point.latitude_deg) for point in stated]).T
    places = selenographic_to_cartesian(longitude, latitude, np.array([point.height_m for point in stated]))
    return GroundTies(
        np.concatenate([ties.image, images]),
        np.concatenate([ties.point, len(ties.places_m) + np.array([names.index(p.name) for p in points])]),
        np.concatenate([ties.pixels, [point.point for point in points]]),
        np.concatenate([ties.sigma_px, [p.point_sigma_px for p in points]]),
        np.concatenate([ties.places_m, places]),
        np.concatenate([ties.place_sigma_m, [point.sigma_m for point in stated]]),
    ), names


def _middle_partials(result: StripAdjustment, terrain: Terrain) -> list[tuple[Floats, Floats]]:
    """Return partials of east and north, m, in the middle of each image by all corrections, and by the height."""
    partials = []
    for k, model in enumerate(result.models):
        middle = 0.5 * (np.array([model.shape[::-1]], dtype=np.float64) - 1.0)
        ground, by_corrections, by_height, _ = ground_partials(model, middle, terrain)
        to_plane = axes_at(ground[0])[:2]
        by_all = np.zeros((2, *result.corrections.shape))
        by_all[:, k] = to_plane @ by_corrections[0]
        partials.append((by_all.reshape(2, -1), to_plane @ by_height[0]))
    return partials


def _search_radius_m(result: StripAdjustment, terrain: Terrain) -> float:
    """Return the largest difference of places in two images to be expected, m."""
    places = [by_all for by_all, _ in _middle_partials(result, terrain)]
    variances = [
        np.einsum("ij,jk,ik->i", first - second, result.covariance, first - second).max()
        for first, second in combinations(places, 2)
    ]
    return _SEARCH_SIGMAS * math.sqrt(max(variances))
