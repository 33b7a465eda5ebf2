"""Descents with random ground, site, Suns, heading, attitude, map and shift of the map, by seed."""

import json
import tempfile
from collections.abc import Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from calibration import Cell, Draws
from procedural_descents import Descent
from procedural_ground import Ground

import radioloc
from radioloc.errors import RadiolocError
from radioloc.imaging import Camera
from radioloc.imaging.orientation import quaternions_from_matrices
from radioloc.imaging.shading import sun_direction
from radioloc.imaging.study import CameraChoice, ImageChoice, ImageStudy
from radioloc.lunar import TangentPlane

SIZE_PX, FRAMES = 256, 12
FOCAL_MM, PIXEL_UM, DISTORTION = 8.3, 6.7 * 1024 / SIZE_PX, (-0.05, 0.0, 0.0, 0.0, 0.0)
HIGHEST_M, LOWEST_M = 6000.0, 4.0
MAP_PIXEL_M, MAP_WIDTH_M = (6.0, 12.0), 9000.0
SUN_ELEVATION_DEG, SUNS_APART_DEG, OBLIQUE_SUNS_APART_DEG = (25.0, 55.0), 20.0, 10.0
TIE_M = (5.0, 40.0)
# Oblique frames: a narrower view keeps the horizon out of frames that are tilted by 60 degrees.
OBLIQUE_FOCAL_MM, OBLIQUE_FRAMES, OBLIQUE_ALTITUDES_M = 20.0, 3, (2000.0, 1000.0)
OBLIQUE_MAP_PIXEL_M, OBLIQUE_MAP_WIDTH_M = (3.0, 5.0), 6000.0
SEED_STEP = 10_000  # beyond the seeds of tests


@dataclass(frozen=True)
class Outcome:
    """Result of one descent."""

    seed: int
    refused: str  # reason without position, else empty
    map_pixel_m: float
    suns_apart_deg: float  # in azimuth
    error_m: tuple[float, float] = (np.nan, np.nan)  # east and north, less the planted shift
    relative: float = np.nan  # chi squared of that error by the covariance without the map's tie
    total: float = np.nan  # chi squared of the error with the shift by the total covariance

    @property
    def pixels(self) -> float:
        """Error in pixels of the map."""
        return float(np.hypot(*self.error_m)) / self.map_pixel_m


def outcome(seed: int, relief: float = 1.0, with_dem: bool = True, tilt_deg: float | None = None) -> Outcome:
    """Draw a descent, write its files, and locate the lander by them, with or without the elevation model.

    All frames of a descent with a tilt are oblique, and show the ground in their middle.
    """
    with tempfile.TemporaryDirectory() as folder:
        return _located(seed, Path(folder), relief, with_dem, tilt_deg)


def _located(seed: int, folder: Path, relief: float, with_dem: bool, tilt_deg: float | None) -> Outcome:
    oblique = tilt_deg is not None
    focal_mm = OBLIQUE_FOCAL_MM if oblique else FOCAL_MM
    map_width_m = OBLIQUE_MAP_WIDTH_M if oblique else MAP_WIDTH_M
    rng = np.random.default_rng([seed, 2021])
    plane = TangentPlane(rng.uniform(-180.0, 180.0), rng.uniform(-60.0, 60.0))
    ground = Ground(plane, seed=seed, level_m=rng.uniform(-3000.0, 1000.0), relief=relief)
    azimuth_deg = rng.uniform(0.0, 360.0)
    apart_deg = rng.uniform(-1.0, 1.0) * (OBLIQUE_SUNS_APART_DEG if oblique else SUNS_APART_DEG)
    elevation_deg, elevation_of_map_deg = rng.uniform(*SUN_ELEVATION_DEG, 2)
    descent = Descent(
        ground,
        Camera.of_pinhole(focal_mm, PIXEL_UM, [0.5 * (SIZE_PX - 1)] * 2, DISTORTION),
        (SIZE_PX, SIZE_PX),
        frames=OBLIQUE_FRAMES if oblique else FRAMES,
        altitudes_m=OBLIQUE_ALTITUDES_M if oblique else (HIGHEST_M, LOWEST_M),
        heading_deg=rng.uniform(0.0, 360.0),
        sun_azimuth_deg=azimuth_deg,
        sun_elevation_deg=elevation_deg,
        seed=seed,
        **({"oblique_above_m": 1.0, "tilt_deg": tilt_deg} if oblique else {}),
    )
    pixel_m = float(np.exp(rng.uniform(*np.log(OBLIQUE_MAP_PIXEL_M if oblique else MAP_PIXEL_M))))
    tie_m = np.exp(rng.uniform(*np.log(TIE_M), 2))
    shift_m = tie_m * rng.normal(size=2)
    sun = sun_direction(azimuth_deg + apart_deg, elevation_of_map_deg)
    ground.write_map(folder / "map.tif", pixel_m, map_width_m, sun, tuple(shift_m))
    ground.write_heights(folder / "dem.tif", 60.0, map_width_m + 1000.0)
    try:
        files = [path for path in descent.write(folder) if path.parent.name == "frames"]
    except RadiolocError as error:  # a hill hides the ground from a low view
        return Outcome(seed, str(error), pixel_m, apart_deg)
    study = ImageStudy(
        ImageChoice(
            files=tuple(files),
            base_map_sigma_m=tuple(tie_m),
            base_map=folder / "map.tif",
            dem=folder / "dem.tif" if with_dem else None,
            rectify=oblique,
            attitudes=_write_attitudes(folder) if oblique else None,
            point=((SIZE_PX - 1) / 2,) * 2 if oblique else "centre",
            point_sigma_px=0.0 if oblique else 1.0,
        ),
        CameraChoice(focal_mm, PIXEL_UM, distortion=DISTORTION),
    )
    try:
        solution = radioloc.imaging.locate_images(study)
    except RadiolocError as error:
        return Outcome(seed, str(error), pixel_m, apart_deg)
    truth = json.loads((folder / "truth.json").read_text())["lander"]
    at_truth = TangentPlane(truth["longitude_deg"], truth["latitude_deg"])
    total_m = at_truth.from_longitude_latitude([solution.position.selenographic[:2]])[0]
    error_m = total_m - shift_m
    relative = error_m @ np.linalg.solve(solution.relative_covariance_en_m2, error_m)
    total = total_m @ np.linalg.solve(solution.covariance_enu_m2[:2, :2], total_m)
    return Outcome(seed, solution.message, pixel_m, apart_deg, tuple(error_m), float(relative), float(total))


def _write_attitudes(folder: Path) -> Path:
    """Write the true attitudes of the frames, as a star tracker would give them."""
    frames = json.loads((folder / "truth.json").read_text())["frames"]
    quaternions = quaternions_from_matrices(np.array([frame["rot_camera_to_moon"] for frame in frames]))
    rows = [f"{f['file']},{','.join(map(str, q))}" for f, q in zip(frames, quaternions, strict=True)]
    path = folder / "attitudes.csv"
    path.write_text("\n".join(["file,qw,qx,qy,qz", *rows]) + "\n")
    return path


def outcomes(
    seeds: Iterable[int], relief: float = 1.0, with_dem: bool = True, tilt_deg: float | None = None
) -> list[Outcome]:
    """Return the outcomes of descents, in parallel processes."""
    located = partial(outcome, relief=relief, with_dem=with_dem, tilt_deg=tilt_deg)
    with ProcessPoolExecutor(mp_context=get_context("spawn")) as pool:
        return list(pool.map(located, seeds))


def calibration_cells() -> list[Cell]:
    """Return the cells of images on flat ground and over relief, with and without elevation model."""
    return [
        Cell(
            f"images, {ground}, {'with' if with_dem else 'without'} elevation model",
            partial(_descents, relief, with_dem),
            max_draws=60,
        )
        for ground, relief in (("flat ground", 0.0), ("relief", 1.0))
        for with_dem in (True, False)
    ]


def _descents(relief: float, with_dem: bool) -> Draws:
    return partial(_squares, relief, with_dem)


def _squares(relief: float, with_dem: bool, numbers: Sequence[int]) -> list[float]:
    """Return chi squared relative to the map of located descents; another one replaces each that is refused."""
    squares = []
    for seed in numbers:
        drawn = outcome(seed, relief, with_dem)
        while drawn.refused:
            drawn = outcome(drawn.seed + SEED_STEP, relief, with_dem)
        squares.append(drawn.relative)
    return squares
