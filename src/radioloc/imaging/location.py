"""Location of a lander by its descent images on a map."""

from __future__ import annotations

import math
import shutil
import tempfile
import weakref
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from radioloc.errors import ConvergenceError, InputError, require_type
from radioloc.imaging.cameras import altitude_m
from radioloc.imaging.frames import find_mask, read_frame, read_mask
from radioloc.imaging.homography import transformed
from radioloc.imaging.image_chain import Detected, Frame
from radioloc.imaging.map_choice import confidence_ellipse, find_candidates, sun_notes
from radioloc.imaging.oblique import read_attitudes
from radioloc.imaging.point_location import FRAME, build_provenance, ground_at, locate_point, locate_stereo
from radioloc.imaging.registration import RegisteredFrame, Registration, register_chain
from radioloc.imaging.self_calibration import NAMES, SelfCalibration
from radioloc.imaging.shading import sun_over_map, write_shaded_map
from radioloc.imaging.solution import ImageSolution, MapResult, PointSolution
from radioloc.imaging.stereo_points import StereoPoints, measure_stereo
from radioloc.imaging.study import (
    BaseMapChoice,
    CameraChoice,
    DescentCameraChoice,
    ImageChoice,
    ImageStudy,
    PointStudy,
    StereoChoice,
    StereoPairChoice,
    read_image_study,
)
from radioloc.lunar import LunarPosition, Map, TerrainModel
from radioloc.lunar.grey_images import Mask
from radioloc.progress import progress_bar
from radioloc.results.recorded import read_recorded
from radioloc.vectors import Floats

# Significance of a radial pattern for zero in place of k1 = -0.05: from 7.6 on level ground, from 9.8 with elevation
# model. For the true distortion over relief: below 2.6 in 19 of 20 descents, once 5.2; below 4.7 with elevation model.
_MIN_DISTORTION_SIGMAS = 5.0
# Half-width of the ground in an image from a landed spacecraft, whose camera is a few metres up.
_MAX_LANDED_HALF_WIDTH_M = 5.0
_MIN_MASK_FRAMES, _MAX_MASK_FRAMES = 4, 12  # from all of the descent, for finding the mask


def locate_images(
    study: ImageStudy | PointStudy | str | Path, *, progress: bool = False
) -> ImageSolution | PointSolution | StereoPoints:
    """Locate a lander by descent images, a point in one image, a rover by landmarks, or the points of a stereo pair.

    Parameters
    ----------
    study : ImageStudy or PointStudy or path-like
        From :func:`~radioloc.imaging.read_image_study`, or the path of its file.
    progress : bool
        Whether a progress bar is shown, on a terminal or in a notebook.

    Returns
    -------
    ImageSolution, PointSolution or StereoPoints
        Position in mean-Earth axes with its covariance, m; of a stereo pair, points in the axes of the body.

    Raises
    ------
    InputError
        A file cannot be used, images are not in order, or a ray does not meet the ground.
    ConvergenceError
        No image is found on the map, or distances fit two places.

    Examples
    --------
    >>> from radioloc.imaging import locate_images
    >>> locate_images("examples/images/descent.toml").converged
    True
    """
    require_type("study", study, ImageStudy, PointStudy, str, Path)
    if isinstance(study, (str, Path)):
        study = read_image_study(study)
    if isinstance(study, PointStudy):
        if isinstance(study.chosen, BaseMapChoice):
            raise InputError(f"{study.name}: [base_map] locates no point; run radioloc base-map")
        if isinstance(study.chosen, StereoPairChoice):
            return measure_stereo(study)
        return locate_stereo(study) if isinstance(study.chosen, StereoChoice) else locate_point(study)
    chosen = study.images
    if not chosen.shade:
        return _locate_on_maps(study, progress)
    scratch = Path(tempfile.mkdtemp(prefix="radioloc-"))
    try:
        shaded, note = _shaded_map(chosen, scratch)
        solution = _locate_lander(study, _frames(study), Map.open(shaded), progress, (note,))
    except BaseException:
        shutil.rmtree(scratch, ignore_errors=True)
        raise
    # Figures read the shaded map again; it is deleted with the solution.
    weakref.finalize(solution, shutil.rmtree, scratch, ignore_errors=True)
    return solution


def _locate_on_maps(study: ImageStudy, progress: bool) -> ImageSolution:
    """Locate the lander on each map that covers the region of the a-priori solution; the first converged one leads."""
    region = None if study.images.near is None else confidence_ellipse(dict(read_recorded(study.images.near)))
    candidates, frames = find_candidates(study.images, region), _frames(study)
    results: list[MapResult] = []
    for candidate in candidates:
        base = candidate.base
        try:
            solution = _locate_lander(study, frames, base, progress, sun_notes([candidate]))
            status = solution.message or "converged"
        except ConvergenceError as error:
            if len(candidates) == 1:
                raise
            solution, status = None, str(error)
        results.append(
            MapResult(base.path.name, base.resolution_m, candidate.sun_difference_deg, status, solution)
        )
    located = [result.solution for result in results if result.solution is not None]
    if not located:
        raise ConvergenceError("; ".join(result.status for result in results))
    leading = next((solution for solution in located if solution.converged), located[0])
    return leading if len(results) == 1 else replace(leading, maps=tuple(results))


class _Frames(NamedTuple):
    """Images of a study, with the features that each map uses again."""

    frames: list[Frame]
    mask: Mask | None
    detected: Detected


def _frames(study: ImageStudy) -> _Frames:
    chosen = study.images
    camera = None if study.camera is None else study.camera.camera
    attitudes = {} if chosen.attitudes is None else read_attitudes(chosen.attitudes)
    frames = [
        Frame(name, partial(read_frame, path), camera, chosen.rectify, attitudes.get(path.name))
        for name, path in zip(_names(chosen.files), chosen.files, strict=True)
    ]
    return _Frames(frames, _mask(chosen), Detected())


def _locate_lander(
    study: ImageStudy, images: _Frames, base: Map, progress: bool, notes: tuple[str, ...]
) -> ImageSolution:
    chosen = study.images
    registration = register_chain(
        images.frames,
        base,
        map_sigma_m=chosen.base_map_sigma_m,
        mask=images.mask,
        search_area=_search_area(chosen),
        terrain=None if study.camera is None or chosen.dem is None else TerrainModel.open(chosen.dem),
        progress=partial(progress_bar, shown=progress, unit="image"),
        detected=images.detected,
    )
    return _solution(study, registration, base, images.mask, notes)


def _names(files: Iterable[Path]) -> list[str]:
    """Return names of files, with their folders if names are equal."""
    paths = list(files)
    names = [path.name for path in paths]
    return names if len(set(names)) == len(names) else [str(path) for path in paths]


def _shaded_map(chosen: ImageChoice, folder: Path) -> tuple[Path, str]:
    """Write the elevation model as a shaded map; return its path and a note about the Sun."""
    assert chosen.dem is not None
    if chosen.epoch is not None:
        azimuth_deg, elevation_deg = sun_over_map(Map.open(chosen.dem), chosen.epoch)
    else:
        assert chosen.sun_azimuth_deg is not None
        assert chosen.sun_elevation_deg is not None
        azimuth_deg, elevation_deg = chosen.sun_azimuth_deg, chosen.sun_elevation_deg
    path = folder / f"{chosen.dem.stem}_shaded.tif"
    write_shaded_map(path, chosen.dem, azimuth_deg, elevation_deg)
    sun = f"azimuth {azimuth_deg:.2f} and elevation {elevation_deg:.2f} degrees over its middle"
    return path, f"{chosen.dem.name} is shaded with the Sun at {sun}"


def _mask(chosen: ImageChoice) -> Mask | None:
    if chosen.mask is not None:
        return read_mask(chosen.mask)
    indices = np.unique(np.linspace(0, len(chosen.files) - 1, _MAX_MASK_FRAMES).astype(int))
    images = []
    for k in indices:
        with suppress(InputError):  # the registration reports the file
            images.append(read_frame(chosen.files[k]))
    same_size = [image for image in images if image.shape == images[0].shape]
    return find_mask(same_size) if len(same_size) >= _MIN_MASK_FRAMES else None


def _search_area(chosen: ImageChoice) -> tuple[float, float, float] | None:
    """Return longitude, latitude, degrees, and radius, m, of the search on the map."""
    if chosen.near is None:
        return None
    content = read_recorded(chosen.near)
    sigma = content.get("sigma") or {}
    sigmas_m = [sigma[key] for key in ("east_m", "north_m") if sigma.get(key) is not None]
    if len(sigmas_m) < 2:
        raise InputError(f"{chosen.near}: expected a solution.json with a determined position")
    place = content["position"]["me"]
    return place["longitude_deg"], place["latitude_deg"], 3.0 * max(sigmas_m) + chosen.near_margin_m


def _solution(
    study: ImageStudy, registration: Registration, base: Map, mask: Mask | None, map_notes: tuple[str, ...]
) -> ImageSolution:
    chosen, frames = study.images, registration.frames
    last = frames[-1]
    message = ""
    if not last.is_registered:
        message = (
            f"the last image, {last.name}, is {last.status.value}; the position is that of an earlier image"
        )
        last = next(frame for frame in reversed(frames) if frame.is_registered)
    pixel = last.centre if message or isinstance(chosen.point, str) else np.array(chosen.point)
    if not (np.abs(pixel - last.centre) <= last.centre + 0.5).all():
        raise InputError(
            f"point: expected a pixel of {last.name} with the middle {last.centre.tolist()}, got {list(chosen.point)}"
        )
    point = registration.ground_point(last.name, pixel, chosen.point_sigma_px)
    camera = study.camera
    self_calibrated = isinstance(camera, DescentCameraChoice) and camera.has_sigmas
    calibration_notes: list[str] = []
    if isinstance(camera, DescentCameraChoice) and self_calibrated:
        calibration = registration.self_calibration(
            camera.focal_length_sigma_mm / camera.focal_length_mm, camera.k1_sigma
        )
        point = registration.calibrated_point(point, calibration, last.name, pixel)
        calibration_notes += _calibration_notes(camera, calibration)
    place = (point.longitude_deg, point.latitude_deg)
    ground = ground_at(chosen, *place)
    covariance = ground.to_enu @ point.covariance_m2 @ ground.to_enu.T
    covariance[2, 2] += ground.sigma_m**2
    notes = [*ground.notes, *calibration_notes]
    if not self_calibrated:
        pattern, corner_px = registration.radial_pattern(), float(np.hypot(*last.centre))
        k1, k1_sigma = float(pattern.values[1]), float(pattern.sigmas[1])
        if abs(k1) > _MIN_DISTORTION_SIGMAS * k1_sigma:
            shift_m = float(np.hypot(*registration.camera_partials(pattern, last.name, pixel)[:, 1] * k1))
            notes.append(
                f"residuals have a radial pattern of {corner_px * k1:.2g} +- {corner_px * k1_sigma:.1g} pixels at the "
                f"corners, as of unknown lens distortion{'' if registration.relief else ' or relief'}; the sigma "
                f"includes {shift_m:.3g} m east and north. Calibrate the camera, and give [camera] distortion"
            )
            covariance += shift_m**2 * ground.to_enu @ ground.to_enu.T
    descent_m = _unknown_descent_m(registration, last) if isinstance(chosen.point, str) else 0.0
    covariance += descent_m**2 * ground.to_enu @ ground.to_enu.T
    altitudes = {} if camera is None else dict(_altitudes(camera, frames))
    if descent_m:
        altitude = f" from {altitudes[last.name]:.3g} m" if last.name in altitudes else ""
        notes.append(
            f"{last.name} shows {2.0 * last.pixel_m * float(last.centre.mean()):.3g} m of ground{altitude}; the sigma "
            f"includes {descent_m:.3g} m east and north for the unknown motion from then to touchdown. Give later "
            "images, or the pixel of the lander as point"
        )
    if not registration.relief:
        notes.append(_plane_note(chosen, camera is not None))
    return ImageSolution(
        study.name,
        message,
        LunarPosition.from_selenographic(*place, ground.height_m, FRAME),
        covariance,
        chosen.dem.name if chosen.shade and chosen.dem is not None else base.path.name,
        chosen.base_map_sigma_m,
        registration,
        base,
        None if camera is None else camera.camera,
        mask,
        altitudes,
        {reference.name: reference.position for reference in study.references},
        (*map_notes, *notes),
        build_provenance(study.path, chosen.files, (*chosen.base_maps, chosen.dem, chosen.mask, chosen.near)),
        dict(zip(_names(chosen.files), chosen.files, strict=True)),
    )


def _calibration_notes(camera: DescentCameraChoice, calibration: SelfCalibration) -> Iterator[str]:
    """Yield a note for each parameter of the camera with an a-priori sigma."""
    scales = camera.focal_length_mm, 1.0
    stated = camera.focal_length_mm, camera.distortion[0]
    for k, (name, unit) in enumerate(zip(NAMES, (" mm", ""), strict=True)):
        sigma, prior = (scales[k] * float(part[k]) for part in (calibration.sigmas, calibration.prior_sigmas))
        if calibration.is_estimated[k]:
            value = stated[k] + scales[k] * float(calibration.values[k])
            yield f"{name} is estimated as {value:.5g}{unit}, sigma {sigma:.2g} (a-priori {prior:.2g})"
        elif prior:
            yield f"{name} is considered: the images do not determine it, sigma {prior:.2g}{unit}"


def _altitudes(camera: CameraChoice, frames: Iterable[RegisteredFrame]) -> Iterator[tuple[str, float]]:
    """Yield the registered images with their altitudes, m; without a pose, those of a camera that looks down."""
    for frame in frames:
        if frame.is_registered:
            shape = (round(2.0 * frame.centre[1] + 1.0), round(2.0 * frame.centre[0] + 1.0))
            downward_m = float(altitude_m(camera.camera(shape), frame.pixel_m))
            yield frame.name, frame.altitude_m if math.isfinite(frame.altitude_m) else downward_m


def _unknown_descent_m(registration: Registration, last: RegisteredFrame) -> float:
    """Return the sigma east and north, m, of the motion after the last image; zero for an image from the ground."""
    half_m = last.pixel_m * float(last.centre.mean())
    if half_m <= _MAX_LANDED_HALF_WIDTH_M:
        return 0.0
    registered = [frame for frame in registration.frames if frame.is_registered]
    earlier = registered[: registered.index(last)]
    drift_m = 0.0
    if earlier and earlier[-1].pixel_m > last.pixel_m:
        moved_m = _middle_m(last) - _middle_m(earlier[-1])
        drift_m = float(np.hypot(*moved_m)) * last.pixel_m / (earlier[-1].pixel_m - last.pixel_m)
    return math.hypot(half_m / math.sqrt(3.0), min(drift_m, 2.0 * half_m))


def _middle_m(frame: RegisteredFrame) -> Floats:
    """Return the place of the middle of an image in the plane of the map, m."""
    assert frame.homography is not None
    return transformed(np.asarray(np.linalg.inv(frame.homography.matrix), np.float64), frame.centre[None])[0]


def _plane_note(chosen: ImageChoice, camera: bool) -> str:
    """Return the note about ground without relief."""
    if camera and chosen.dem is not None:
        reason = f"{chosen.dem.name} does not cover the ground of some image"
    else:
        reason = "relief is modelled with both dem and [camera]"
    altitudes = "; altitudes are those of a camera that looks straight down" if camera else ""
    return (
        f"the ground is taken as a plane, so that relief shifts points of oblique images: {reason}{altitudes}"
    )
