"""Locating a rover or lander by its stereo images of landmarks that a map shows (Chang'e-3 descent images, 2014)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from radioloc.constants import MEAN_LUNAR_RADIUS_M
from radioloc.errors import InputError
from radioloc.imaging import StereoPair, TangentPlane, body_position, resect
from radioloc.lunar import LunarPosition
from radioloc.report.cards import Field, metres
from radioloc.report.image_solution import MAP_TIE
from radioloc.report.point_solution import ErrorSource, PointSolution
from radioloc.studies.image_inputs import FRAME, ground_at, provenance_of
from radioloc.studies.image_study import PointStudy, StereoChoice

Floats = NDArray[np.float64]

_UNLIKELY = 1e-3
"""Chance of distances below which they do not agree with the map."""
_FARTHEST_M = 10e3
_MISFIT = 3.29
"""Sigmas by which rays pass each other once in 1000."""


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
    body = body_position(
        [*found.position_m, 0.0], _rot_body_to_enu(*chosen.body_attitude_deg), chosen.camera_in_body_m
    )[:2]
    longitude, latitude = plane.to_longitude_latitude(body[None] / scale)[0]
    ground = ground_at(chosen, longitude, latitude)
    # What errors of distances and of landmarks do, by the gain of the least squares.
    unit = (found.position_m - landmarks) / np.linalg.norm(found.position_m - landmarks, axis=1)[:, None]
    gain = found.covariance_m2 @ unit.T / (measured.sigmas_m**2 + chosen.landmark_sigma_m**2)
    ties = tuple(
        (f"{MAP_TIE}.{chosen.map_name}.{axis}", "m", sigma_m)
        for axis, sigma_m in zip(("east", "north"), chosen.map_sigma_m, strict=True)
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
