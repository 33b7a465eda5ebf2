"""Location of a point in one image, or of a rover or lander by its stereo images of landmarks on a map.

Stereo images are used as for Chang'e-3 (descent images, 2014). The height of the ground and the provenance of results
serve all studies of images.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from radioloc.constants import MEAN_LUNAR_RADIUS_M
from radioloc.errors import CoverageError, InputError
from radioloc.imaging import ImagePointSigmas, LineScanModel, Sphere, Terrain, locate_image_point, read_isd
from radioloc.imaging.isd import SupportData
from radioloc.imaging.solution import ErrorSource, PointSolution
from radioloc.imaging.stereo import StereoPair, resect
from radioloc.imaging.study import GroundChoice, ImagePointChoice, PointStudy, StereoChoice, StereoPairChoice
from radioloc.kernels.files import sha256_of
from radioloc.lunar import LunarPosition, TangentPlane, TerrainModel, east_north_up
from radioloc.lunar.terrain import height_and_gradient
from radioloc.results.cards import Field, metres
from radioloc.study.record import versions
from radioloc.targets.position_prior import map_tie_names
from radioloc.time import Epochs, to_scale, utc_strings
from radioloc.vectors import Floats

FRAME = "ME_DE421"  # axes of lunar maps
_MIN_PROBABILITY = 1e-3  # of chi squared of distances that agree with the map
_MAX_SPREAD_M = 10e3  # of landmarks
MAX_MISFIT_SIGMAS = 3.29  # of the separation of two rays, exceeded with a probability of 1 in 1000


class Ground(NamedTuple):
    """Height of the ground at a place."""

    height_m: float
    sigma_m: float  # NaN for an undetermined height
    to_enu: Floats  # (3, 2): east, north and up on the ground by east and north
    notes: tuple[str, ...]


def ground_at(chosen: GroundChoice, longitude_deg: float, latitude_deg: float) -> Ground:
    """Return the height of the ground with its sigma, and its slope."""
    if chosen.height_m is not None:
        return Ground(chosen.height_m, chosen.height_sigma_m, np.eye(3)[:, :2], ())
    if chosen.dem is None:
        note = "the height is undetermined, and set to that of the sphere of 1737.4 km; give dem or height_m"
        return Ground(0.0, math.nan, np.vstack([np.eye(2), [math.nan, math.nan]]), (note,))
    place = np.radians(longitude_deg), np.radians(latitude_deg)
    height_m, gradient = height_and_gradient(TerrainModel.open(chosen.dem).height_and_slope, *place)
    slope = east_north_up(*place)[:2] @ gradient / (MEAN_LUNAR_RADIUS_M + height_m)
    return Ground(float(height_m), chosen.dem_sigma_m, np.vstack([np.eye(2), slope]), ())


def build_provenance(
    study: Path | None, images: Iterable[Path], inputs: Iterable[Path | None]
) -> dict[str, Any]:
    """Return the provenance of a solution: versions, the study with its files, and the files with measurements."""
    measured = [*images] or ([] if study is None else [study])
    files = dict.fromkeys([*measured, *(path for path in inputs if path is not None)])
    origin = None
    if study is not None:
        origin = {
            "file": str(study.resolve()),
            "sha256": sha256_of(study),
            "hours": None,
            "inputs": [{"file": path.name, "sha256": sha256_of(path)} for path in files],
        }
    return {**versions(), "study": origin, "files": [path.name for path in measured]}


class _Distances(NamedTuple):
    """Horizontal distances of landmarks."""

    values_m: Floats
    sigmas_m: Floats
    misfits: Floats  # separation of the rays, sigmas; NaN for distances in the study


def locate_stereo(study: PointStudy) -> PointSolution:
    """Locate the rover or lander of ``[stereo]``."""
    chosen = study.chosen
    assert isinstance(chosen, StereoChoice)
    names = [landmark.name for landmark in chosen.landmarks]
    degrees = np.array([[landmark.longitude_deg, landmark.latitude_deg] for landmark in chosen.landmarks])
    plane = TangentPlane(*(float(value) for value in degrees[0]))
    on_sphere = plane.from_longitude_latitude(degrees)
    for name, place in zip(names, on_sphere, strict=True):
        if not np.linalg.norm(place) < _MAX_SPREAD_M:  # NaN on the opposite side of the Moon
            raise InputError(
                f"landmark {name!r} is farther than {_MAX_SPREAD_M / 1e3:.0f} km from landmark {names[0]!r}; check "
                "longitude_deg (east) and latitude_deg"
            )
    middle = plane.to_longitude_latitude(on_sphere.mean(axis=0, keepdims=True))[0]
    # Distances on high ground are larger than on the sphere of the map.
    scale = 1.0 + ground_at(chosen, *middle).height_m / MEAN_LUNAR_RADIUS_M
    landmarks = scale * on_sphere
    measured = _distances(chosen)
    fit = resect(landmarks, measured.values_m, measured.sigmas_m, chosen.landmark_sigma_m)
    # The mounting leads from the camera to the body (Chang'e-3 descent images 2014, equation 7).
    mounting_m = _rot_body_to_enu(*chosen.body_attitude_deg) @ chosen.camera_in_body_m
    body = fit.position_m - mounting_m[:2]
    longitude, latitude = plane.to_longitude_latitude(body[None] / scale)[0]
    ground = ground_at(chosen, longitude, latitude)
    # The gain of the least squares maps errors of distances and of landmarks to the position.
    unit = (fit.position_m - landmarks) / np.linalg.norm(fit.position_m - landmarks, axis=1)[:, None]
    gain = fit.covariance_m2 @ unit.T / (measured.sigmas_m**2 + chosen.landmark_sigma_m**2)
    ties = tuple(
        (name, "m", sigma_m)
        for name, sigma_m in zip(map_tie_names(chosen.map_name), chosen.map_sigma_m, strict=True)
    )
    sources = (
        ErrorSource("distances", ground.to_enu @ gain * measured.sigmas_m),
        ErrorSource("landmarks", ground.to_enu @ gain * chosen.landmark_sigma_m),
        ErrorSource(f"tie of {chosen.map_name}", ground.to_enu * chosen.map_sigma_m, ties),
        ErrorSource("height", np.array([[0.0], [0.0], [ground.sigma_m]])),
    )
    residuals_m = fit.residuals_m
    weights = 1.0 / (measured.sigmas_m**2 + chosen.landmark_sigma_m**2)
    return PointSolution(
        study.name,
        "stereo",
        _inconsistency(names, measured, residuals_m * np.sqrt(weights), fit.chi2),
        LunarPosition.from_selenographic(longitude, latitude, ground.height_m, FRAME),
        sources,
        (_field(names, measured, residuals_m, fit.chi2),),
        {
            "chi2": fit.chi2,
            "dof": len(names) - 2,
            "landmarks": [
                {
                    "name": name,
                    "distance_m": distance_m,
                    "sigma_m": sigma_m,
                    "residual_m": residual_m,
                    "misfit_sigmas": None if np.isnan(misfit) else misfit,
                }
                for name, distance_m, sigma_m, misfit, residual_m in zip(
                    names, *(part.tolist() for part in (*measured, residuals_m)), strict=True
                )
            ],
        },
        len(names),
        float(np.sqrt(np.average(residuals_m**2, weights=weights))),
        {reference.name: reference.position for reference in study.references},
        ground.notes,
        build_provenance(study.path, (), (chosen.dem,)),
        landmarks - body,
        measured.values_m,
    )


def _distances(chosen: StereoChoice) -> _Distances:
    """Return the horizontal distances of the study, or those from the rays of both cameras."""
    landmarks = chosen.landmarks
    values = np.array([landmark.distance_m or np.nan for landmark in landmarks])
    sigmas = np.array([landmark.distance_sigma_m or np.nan for landmark in landmarks])
    misfits = np.full(len(landmarks), np.nan)
    rows = [k for k, landmark in enumerate(landmarks) if landmark.left_px is not None]
    if rows:
        left, right = ([getattr(landmarks[k], name) for k in rows] for name in ("left_px", "right_px"))
        points = stereo_pair(chosen).intersect(left, right, chosen.point_sigma_px)
        up = np.array([_up_in_camera(landmarks[k].pitch_deg, landmarks[k].roll_deg) for k in rows])
        level = points.points_m - np.sum(points.points_m * up, axis=1)[:, None] * up
        values[rows] = np.linalg.norm(level, axis=1)
        toward = level / values[rows][:, None]
        sigmas[rows] = np.sqrt(np.einsum("ni,nij,nj->n", toward, points.covariance_m2, toward))
        misfits[rows] = points.misfit
    return _Distances(values, sigmas, misfits)


def stereo_pair(chosen: StereoChoice | StereoPairChoice, shape: tuple[int, int] = (0, 0)) -> StereoPair:
    """Return the calibrated cameras of a study, for images of a shape (lines, samples)."""
    from scipy.spatial.transform import Rotation

    assert chosen.left is not None
    assert chosen.right is not None
    assert chosen.baseline_m is not None
    # A rotation of the axes is the inverse rotation of the components of a vector.
    rotation = Rotation.from_rotvec(chosen.rotation_deg, degrees=True).as_matrix().T
    baseline_m = np.array(chosen.baseline_m)
    return StereoPair(chosen.left.camera(shape), chosen.right.camera(shape), baseline_m, rotation)


def _up_in_camera(pitch_deg: float, roll_deg: float) -> Floats:
    """Return the vertical in the axes of a camera (right, down, ahead), from pitch and clockwise roll."""
    (sin_pitch, sin_roll), (cos_pitch, cos_roll) = (
        function(np.radians([pitch_deg, roll_deg])) for function in (np.sin, np.cos)
    )
    return np.array([-cos_pitch * sin_roll, -cos_pitch * cos_roll, sin_pitch])


def _rot_body_to_enu(heading_deg: float, pitch_deg: float, roll_deg: float) -> Floats:
    """Return the rotation from the body's axes (ahead, right, down) to east, north, up."""
    from scipy.spatial.transform import Rotation

    to_ned = Rotation.from_euler("ZYX", [heading_deg, pitch_deg, roll_deg], degrees=True).as_matrix()
    return np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]) @ to_ned


def _inconsistency(names: list[str], measured: _Distances, residual_sigmas: Floats, chi2: float) -> str:
    """Return the reason if rays or distances are inconsistent, else an empty text."""
    from scipy.stats import chi2 as chi_squared

    misfits = np.nan_to_num(measured.misfits)
    if misfits.max() > MAX_MISFIT_SIGMAS:
        worst = int(np.argmax(misfits))
        return (
            f"the rays of landmark {names[worst]} are {misfits[worst]:.1f} sigmas apart; check that it is the same "
            "point in both images"
        )
    if chi_squared.sf(chi2, len(names) - 2) < _MIN_PROBABILITY:
        worst = int(np.argmax(np.abs(residual_sigmas)))
        return (
            f"the distances do not agree with the map; the largest residual, of landmark {names[worst]}, is "
            f"{abs(residual_sigmas[worst]):.1f} sigmas; check that it is the same landmark"
        )
    return ""


def _field(names: list[str], measured: _Distances, residuals_m: Floats, chi2: float) -> Field:
    rows = [
        (
            name,
            f"{distance_m:.3f}",
            metres(sigma_m),
            f"{residual_m:+.3f}",
            "-" if np.isnan(misfit) else f"{misfit:.2f}",
        )
        for name, distance_m, sigma_m, misfit, residual_m in zip(names, *measured, residuals_m, strict=True)
    ]
    heading = ("landmark", "distance, m", "sigma, m", "residual, m", "rays, sigmas")
    return Field(
        "distances", (), heading, rows, (f"chi-square {chi2:.2f} of {len(names) - 2} degrees of freedom",)
    )


def mean_earth_support(path: Path) -> SupportData:
    """Read the sensor model of an image in mean-Earth axes."""
    support = read_isd(path)
    return support if support.model.axes.startswith("ME_") else read_isd(path, axes=FRAME)


def locate_point(study: PointStudy) -> PointSolution:
    """Locate the point of ``[image_point]``."""
    chosen = study.chosen
    assert isinstance(chosen, ImagePointChoice)
    support = mean_earth_support(chosen.model)
    model = support.model
    if chosen.dem is not None:
        surface: Terrain | Sphere = Terrain(TerrainModel.open(chosen.dem))
        height_name, sigma_m = chosen.dem.name, chosen.dem_sigma_m
    else:
        assert chosen.height_m is not None
        surface = Sphere(MEAN_LUNAR_RADIUS_M + chosen.height_m)
        height_name, sigma_m = study.name, chosen.height_sigma_m
    sigmas = ImagePointSigmas(
        chosen.point_sigma_px, chosen.position_sigma_m, chosen.attitude_sigma_rad, sigma_m
    )
    point = locate_image_point(model, chosen.point, surface, sigmas)
    image = chosen.model.name
    enu = ("east", "north", "up")
    orbit_names = [f"orbit.{axis}.{image}" for axis in enu]
    pointing_names = [f"pointing.{axis}.{image}" for axis in "xyz"]
    orbit = zip(orbit_names, "mmm", chosen.position_sigma_m, strict=True)
    pointing = zip(pointing_names, ["rad"] * 3, chosen.attitude_sigma_rad, strict=True)
    sources = (
        ErrorSource("pixel", point.errors_enu_m["pixel"]),
        ErrorSource("orbit", point.errors_enu_m["position"], tuple(orbit)),
        ErrorSource("pointing", point.errors_enu_m["attitude"], tuple(pointing)),
        ErrorSource("height", point.errors_enu_m["height"], ((f"height.{height_name}", "m", sigma_m),)),
    )
    rays = model.rays([point.pixel])
    up = point.position_me.xyz_m / np.linalg.norm(point.position_me.xyz_m)
    emission_deg = math.degrees(math.acos(min(1.0, float(-rays.directions[0] @ up))))
    time_s = 0.0
    if isinstance(model, LineScanModel):
        time_s = float(model.times_s(np.array([point.pixel[1]]))[0][0])
    epochs = Epochs.from_tdb_seconds([support.epoch_tdb_s]).shifted(time_s)
    with suppress(CoverageError):  # before 1972, as Apollo's images, epochs stay TDB
        epochs = to_scale(epochs, "UTC")
    epoch = f"{utc_strings(epochs, 3)[0]} {epochs.scale}"
    sensor = " ".join(part for part in (support.platform, support.sensor) if part)
    by_sample_m, by_line_m = point.pixel_size_m
    lines = (
        f"{image}{f', {sensor}' if sensor else ''}, {epoch}",
        f"point at sample {point.pixel[0]:.2f}, line {point.pixel[1]:.2f}; pixels of {by_sample_m:.3g} x "
        f"{by_line_m:.3g} m on the ground, seen from {emission_deg:.1f} deg off the vertical",
    )
    details = {
        "model": image,
        "sensor": sensor,
        "epoch": epoch,
        "point_px": list(point.pixel),
        "pixel_size_m": [by_sample_m, by_line_m],
        "emission_deg": emission_deg,
    }
    return PointSolution(
        study.name,
        "image_point",
        "",
        point.position_me,
        sources,
        (Field("image", lines),),
        details,
        1,
        references={reference.name: reference.position for reference in study.references},
        provenance=build_provenance(study.path, (), (chosen.model, chosen.dem)),
    )
