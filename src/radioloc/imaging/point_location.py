"""Locating a point that one image shows, or a rover or lander by its stereo images of landmarks that a map shows.

The latter as of Chang'e-3 (descent images, 2014). Here is also what all studies of images have in common: the ground's
height at a place, and what a result was made from.
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
from radioloc.imaging.solution import ErrorSource, PointSolution
from radioloc.imaging.stereo import StereoPair, resect
from radioloc.imaging.study import GroundChoice, ImagePointChoice, PointStudy, StereoChoice
from radioloc.kernels import sha256_of
from radioloc.lunar import LunarPosition, TangentPlane, TerrainModel, east_north_up
from radioloc.lunar.terrain import height_and_gradient
from radioloc.results.cards import Field, metres
from radioloc.study.record import versions
from radioloc.targets.position_prior import map_tie_names
from radioloc.time import Epochs, to_scale, utc_strings
from radioloc.vectors import Floats

FRAME = "ME_DE421"
"""The axes of lunar maps."""

_UNLIKELY = 1e-3  # chance of distances below which they do not agree with the map
_FARTHEST_M = 10e3
_MISFIT = 3.29  # sigmas by which rays pass each other once in 1000


class Ground(NamedTuple):
    """The ground at a place."""

    height_m: float
    sigma_m: float  # NaN where nothing tells the height
    to_enu: Floats  # (3, 2): east, north and up on the ground by east and north
    notes: tuple[str, ...]


def ground_at(chosen: GroundChoice, longitude_deg: float, latitude_deg: float) -> Ground:
    """The height of the ground as far as it is known, and how it follows the place."""
    if chosen.height_m is not None:
        return Ground(chosen.height_m, chosen.height_sigma_m, np.eye(3)[:, :2], ())
    if chosen.dem is None:
        note = "no height is known: give dem or height_m; the position stands on the sphere of 1737.4 km"
        return Ground(0.0, math.nan, np.vstack([np.eye(2), [math.nan, math.nan]]), (note,))
    place = np.radians(longitude_deg), np.radians(latitude_deg)
    height_m, gradient = height_and_gradient(TerrainModel.open(chosen.dem).height_and_slope, *place)
    slope = east_north_up(*place)[:2] @ gradient / (MEAN_LUNAR_RADIUS_M + height_m)
    return Ground(float(height_m), chosen.dem_sigma_m, np.vstack([np.eye(2), slope]), ())


def provenance_of(
    study: Path | None, images: Iterable[Path], others: Iterable[Path | None]
) -> dict[str, Any]:
    """What a solution is from: the study, the images that it measures or else its own numbers, and other files."""
    measured = [*images] or ([] if study is None else [study])
    files = dict.fromkeys([*measured, *(path for path in others if path is not None)])
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
    misfits: Floats  # of the rays, sigmas; NaN for distances that are given


def locate_stereo(study: PointStudy) -> PointSolution:
    """Locate the rover or lander of ``[stereo]``."""
    chosen = study.chosen
    assert isinstance(chosen, StereoChoice)
    names = [one.name for one in chosen.landmarks]
    degrees = np.array([[one.longitude_deg, one.latitude_deg] for one in chosen.landmarks])
    plane = TangentPlane(*(float(value) for value in degrees[0]))
    on_sphere = plane.from_longitude_latitude(degrees)
    for name, place in zip(names, on_sphere, strict=True):
        if not np.linalg.norm(place) < _FARTHEST_M:  # NaN on the other side of the Moon
            raise InputError(
                f"landmark {name!r} is farther than {_FARTHEST_M / 1e3:.0f} km from landmark {names[0]!r}; give "
                "longitude_deg to the east and latitude_deg to the north"
            )
    middle = plane.to_longitude_latitude(on_sphere.mean(axis=0, keepdims=True))[0]
    # Distances on the ground are larger than on the sphere of the map, where the ground is higher.
    scale = 1.0 + ground_at(chosen, *middle).height_m / MEAN_LUNAR_RADIUS_M
    landmarks = scale * on_sphere
    measured = _distances(chosen)
    found = resect(landmarks, measured.values_m, measured.sigmas_m, chosen.landmark_sigma_m)
    # The mounting leads from the camera to the body (Chang'e-3 descent images 2014, equation 7).
    mounting_m = _rot_body_to_enu(*chosen.body_attitude_deg) @ chosen.camera_in_body_m
    body = found.position_m - mounting_m[:2]
    longitude, latitude = plane.to_longitude_latitude(body[None] / scale)[0]
    ground = ground_at(chosen, longitude, latitude)
    # What errors of distances and of landmarks do, by the gain of the least squares.
    unit = (found.position_m - landmarks) / np.linalg.norm(found.position_m - landmarks, axis=1)[:, None]
    gain = found.covariance_m2 @ unit.T / (measured.sigmas_m**2 + chosen.landmark_sigma_m**2)
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
    residuals_m = found.residuals_m
    freedom = len(names) - 2
    weights = 1.0 / (measured.sigmas_m**2 + chosen.landmark_sigma_m**2)
    return PointSolution(
        study.name,
        "stereo",
        _complaint(names, measured, residuals_m * np.sqrt(weights), found.chi2),
        LunarPosition.from_selenographic(longitude, latitude, ground.height_m, FRAME),
        sources,
        (_field(names, measured, residuals_m, found.chi2),),
        {
            "chi2": found.chi2,
            "dof": freedom,
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
        {one.name: one.position for one in study.references},
        ground.notes,
        provenance_of(study.path, (), (chosen.dem,)),
        landmarks - body,
        measured.values_m,
    )


def _distances(chosen: StereoChoice) -> _Distances:
    """Horizontal distances as given, or from the rays of both cameras."""
    values, sigmas = (
        np.array([np.nan if value is None else value for value in given])
        for given in zip(*((one.distance_m, one.distance_sigma_m) for one in chosen.landmarks), strict=True)
    )
    misfits = np.full(len(values), np.nan)
    seen = [k for k, one in enumerate(chosen.landmarks) if one.left_px is not None]
    if seen:
        left, right = ([getattr(chosen.landmarks[k], name) for k in seen] for name in ("left_px", "right_px"))
        points = _pair(chosen).intersect(left, right, chosen.point_sigma_px)
        up = np.array(
            [_up_in_camera(chosen.landmarks[k].pitch_deg, chosen.landmarks[k].roll_deg) for k in seen]
        )
        level = points.points_m - np.sum(points.points_m * up, axis=1)[:, None] * up
        values[seen] = np.linalg.norm(level, axis=1)
        toward = level / values[seen][:, None]
        sigmas[seen] = np.sqrt(np.einsum("ni,nij,nj->n", toward, points.covariance_m2, toward))
        misfits[seen] = points.misfit
    return _Distances(values, sigmas, misfits)


def _pair(chosen: StereoChoice) -> StereoPair:
    from scipy.spatial.transform import Rotation

    assert chosen.left is not None
    assert chosen.right is not None
    assert chosen.baseline_m is not None
    # Turning the axes one way turns the components of a vector the other.
    rotation = Rotation.from_rotvec(chosen.rotation_deg, degrees=True).as_matrix().T
    left, right = (camera.camera((0, 0)) for camera in (chosen.left, chosen.right))
    return StereoPair(left, right, np.array(chosen.baseline_m), rotation)


def _up_in_camera(pitch_deg: float, roll_deg: float) -> Floats:
    """Up, in the axes of a camera (right, down, ahead) whose axis is so far above the horizon, turned clockwise."""
    (sin_pitch, sin_roll), (cos_pitch, cos_roll) = (
        function(np.radians([pitch_deg, roll_deg])) for function in (np.sin, np.cos)
    )
    return np.array([-cos_pitch * sin_roll, -cos_pitch * cos_roll, sin_pitch])


def _rot_body_to_enu(heading_deg: float, pitch_deg: float, roll_deg: float) -> Floats:
    """From the body's axes (ahead, right, down) to east, north, up."""
    from scipy.spatial.transform import Rotation

    to_ned = Rotation.from_euler("ZYX", [heading_deg, pitch_deg, roll_deg], degrees=True).as_matrix()
    return np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]) @ to_ned


def _complaint(names: list[str], measured: _Distances, in_sigmas: Floats, chi2: float) -> str:
    """Why the position cannot be used; empty where it can."""
    from scipy.stats import chi2 as chi_squared

    apart = np.nan_to_num(measured.misfits)
    if apart.max() > _MISFIT:
        worst = int(np.argmax(apart))
        return (
            f"the rays of landmark {names[worst]} pass each other by {apart[worst]:.1f} sigmas; "
            "is it the same point in both images?"
        )
    if chi_squared.sf(chi2, len(names) - 2) < _UNLIKELY:
        worst = int(np.argmax(np.abs(in_sigmas)))
        return (
            f"the distances do not agree with the map, most of all that of landmark {names[worst]}, by "
            f"{abs(in_sigmas[worst]):.1f} sigmas; is it the same landmark?"
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


def locate_point(study: PointStudy) -> PointSolution:
    """Locate the point of ``[image_point]``."""
    chosen = study.chosen
    assert isinstance(chosen, ImagePointChoice)
    support = read_isd(chosen.model)
    if not support.model.axes.startswith("ME_"):
        support = read_isd(chosen.model, axes=FRAME)
    model = support.model
    if chosen.dem is not None:
        surface: Terrain | Sphere = Terrain(TerrainModel.open(chosen.dem))
        of_height, sigma_m = chosen.dem.name, chosen.dem_sigma_m
    else:
        assert chosen.height_m is not None
        surface = Sphere(MEAN_LUNAR_RADIUS_M + chosen.height_m)
        of_height, sigma_m = study.name, chosen.height_sigma_m
    sigmas = ImagePointSigmas(
        chosen.point_sigma_px, chosen.position_sigma_m, chosen.attitude_sigma_rad, sigma_m
    )
    found = locate_image_point(model, chosen.point, surface, sigmas)
    image = chosen.model.name
    of_image = (
        ("position", "orbit", "m", ("east", "north", "up"), chosen.position_sigma_m),
        ("attitude", "pointing", "rad", ("x", "y", "z"), chosen.attitude_sigma_rad),
    )
    sources = (
        ErrorSource("pixel", found.errors_enu_m["pixel"]),
        *(
            ErrorSource(
                name,
                found.errors_enu_m[part],
                tuple(
                    (f"{name}.{axis}.{image}", unit, sigma) for axis, sigma in zip(axes, each, strict=True)
                ),
            )
            for part, name, unit, axes, each in of_image
        ),
        ErrorSource("height", found.errors_enu_m["height"], ((f"height.{of_height}", "m", sigma_m),)),
    )
    rays = model.rays([found.pixel])
    up = found.position_me.xyz_m / np.linalg.norm(found.position_me.xyz_m)
    emission_deg = math.degrees(math.acos(min(1.0, float(-rays.directions[0] @ up))))
    time_s = 0.0
    if isinstance(model, LineScanModel):
        time_s = float(model.times_s(np.array([found.pixel[1]]))[0][0])
    taken = Epochs.from_tdb_seconds([support.epoch_tdb_s]).shifted(time_s)
    with suppress(CoverageError):  # before 1972, as Apollo's images, it stays TDB
        taken = to_scale(taken, "UTC")
    epoch = f"{utc_strings(taken, 3)[0]} {taken.scale}"
    sensor = " ".join(part for part in (support.platform, support.sensor) if part)
    across_m, along_m = found.pixel_size_m
    lines = (
        f"{image}{f', {sensor}' if sensor else ''}, {epoch}",
        f"point at sample {found.pixel[0]:.2f}, line {found.pixel[1]:.2f}; pixels of {across_m:.3g} x {along_m:.3g} m "
        f"on the ground, seen from {emission_deg:.1f} deg off the vertical",
    )
    details = {
        "model": image,
        "sensor": sensor,
        "epoch": epoch,
        "point_px": list(found.pixel),
        "pixel_size_m": [across_m, along_m],
        "emission_deg": emission_deg,
    }
    return PointSolution(
        study.name,
        "image_point",
        "",
        found.position_me,
        sources,
        (Field("image", lines),),
        details,
        1,
        references={one.name: one.position for one in study.references},
        provenance=provenance_of(study.path, (), (chosen.model, chosen.dem)),
    )
