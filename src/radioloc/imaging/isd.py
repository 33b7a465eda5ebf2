"""Image support data of USGS (ISD, JSON): sensor models of images.

ALE writes these files for the Community Sensor Models of USGS (``usgscsm``). The centre of their first pixel is
(0.5, 0.5), also for a detector's centre; half a pixel is subtracted. Lengths are kilometres, on the focal plane
millimetres; epochs are TDB seconds since J2000; quaternions and constant rotations turn vectors from J2000 to the
camera or the Moon.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from radioloc import vectors
from radioloc.ephemeris.orientation import LUNAR_AXES
from radioloc.errors import FileFormatError, InputError, in_file
from radioloc.imaging.cameras import Camera
from radioloc.imaging.distortion import KINDS, Distortion
from radioloc.imaging.labels import Keys, is_isis_cube, isd_of_cube
from radioloc.imaging.orientation import (
    ConstantOrientation,
    TabulatedOrientation,
    matrices_from_quaternions,
    quaternions_from_matrices,
    slerp,
)
from radioloc.imaging.sensor_models import FrameModel, LineScanModel
from radioloc.lunar.frames import rot_icrf_to_me
from radioloc.text_files import json_file
from radioloc.time import Epochs
from radioloc.vectors import Floats

_FRAME, _LINE_SCAN = "USGS_ASTRO_FRAME_SENSOR_MODEL", "USGS_ASTRO_LINE_SCANNER_SENSOR_MODEL"
_UNITS_M = {"m": 1.0, "km": 1e3}
_SUMMING_LIMITS = 1e-3, 1e4  # detector pixels per image pixel
_CSM_CENTRE = 0.5  # of the first pixel
_AXES = {code: axes.frame for code, axes in LUNAR_AXES.items()} | {10020: "IAU_MOON"}  # by NAIF code
# Largest distance of an image's tables from its middle: line-scan images take seconds to minutes.
_MAX_FROM_EPOCH_S = 86400.0
_STATE_STEP_S = 1e-3
_PIXEL_AXES = "sample", "line"
_NOT_SUPPORT_DATA = "expected the JSON of an ISD or an ISIS cube, got neither; make the file again"


@dataclass(frozen=True, slots=True, eq=False)
class SupportData:
    """Sensor model of one image with its epoch."""

    model: FrameModel | LineScanModel
    radius_m: float  # of the Moon in the file
    epoch_tdb_s: float  # TDB seconds since J2000 at which the model's times are zero
    sun_m: Floats | None = None  # in the model's axes, shape (3,)
    platform: str = ""
    sensor: str = ""


def read_isd(path: str | Path, *, axes: str | None = None) -> SupportData:
    """Read the sensor model of an image from its support data.

    Parameters
    ----------
    path : path-like
        An ISD (JSON), plain or gzip, of a frame or a line-scan camera; or an ISIS cube of LRO's NACL or NACR, whole or
        cut out, on which ``spiceinit`` was run.
    axes : str, optional
        ``"ME_DE421"`` turns from J2000 to the Moon by the lunar orientation of DE421 instead of the file's rotation:
        for files in other axes than maps, such as the IAU's mean rotation, up to 155 m away.

    Returns
    -------
    SupportData
        Sensor model with positions in m, and the epoch of its times, TDB.

    Raises
    ------
    FileFormatError
        Missing file, neither JSON nor a cube, missing key or unusable value (it is named), unsupported sensor.

    Examples
    --------
    >>> from radioloc.imaging import read_isd  # doctest: +SKIP
    >>> read_isd("M102128467LE.json").model.axes  # doctest: +SKIP
    'ME_DE421'
    """
    if axes not in (None, "ME_DE421"):
        raise InputError(f"axes: expected 'ME_DE421' or None for the axes of the file, got {axes!r}")
    if is_isis_cube(path):
        keys = Keys(path, isd_of_cube(path))
    else:
        with json_file(path, _NOT_SUPPORT_DATA) as content:
            keys = Keys(path, content)
    name = keys.text("name_model")
    if name not in (_FRAME, _LINE_SCAN):
        raise FileFormatError(path, f"name_model: expected {_FRAME} or {_LINE_SCAN}, got {name!r}")
    with in_file(path):
        return _support_data(keys, name == _LINE_SCAN, axes)


def _support_data(keys: Keys, scan: bool, axes: str | None) -> SupportData:
    epoch = keys.number("center_ephemeris_time")
    shape = (keys.count("image_lines"), keys.count("image_samples"))
    radius_m = keys.number("radii.semimajor") * _unit_m(keys, "radii.unit")
    if abs(keys.number("radii.semiminor") * _unit_m(keys, "radii.unit") - radius_m) > 1.0:
        raise FileFormatError(keys.path, "radii: expected those of a sphere")
    rotation_times = _times(keys, "body_rotation", epoch)
    to_moon = _rotations(keys, "body_rotation")

    def rot_j2000_to_moon(times_s: Floats) -> Floats:
        if axes is not None:
            return rot_icrf_to_me(Epochs.from_tdb_seconds(np.full(len(times_s), epoch)).shifted(times_s))
        return slerp(rotation_times, to_moon, times_s)

    frames = [
        int(code)
        for part in ("constant_frames", "time_dependent_frames")
        for code in keys.numbers(f"body_rotation.{part}", (None,), [])
    ]
    axes_name = axes or (_AXES.get(frames[0], f"NAIF_{frames[0]}") if frames else "unknown")
    position_times, positions, velocities = _states(keys, "instrument_position", epoch, rot_j2000_to_moon)
    pointing_times = _times(keys, "instrument_pointing", epoch)
    to_camera = _rotations(keys, "instrument_pointing")
    rotations = rot_j2000_to_moon(pointing_times) @ np.swapaxes(to_camera, 1, 2)
    sun_m = None
    if keys.has("sun_position"):
        sun_times, sun, _ = _states(keys, "sun_position", epoch, rot_j2000_to_moon)
        sun_m = np.array([np.interp(0.0, sun_times, component) for component in sun.T])
    orientation: ConstantOrientation | TabulatedOrientation
    if len(position_times) == len(pointing_times) == 1:
        orientation = ConstantOrientation(positions[0], rotations[0])
    else:
        table = (position_times, positions, pointing_times, quaternions_from_matrices(rotations), velocities)
        orientation = TabulatedOrientation(*table)
    middle = np.array([0.0 if not scan else 0.5 * sum(orientation.span_s)])
    [position], [rotation] = orientation.poses(middle)
    camera = _camera(keys, scan, -position @ rotation)
    model: FrameModel | LineScanModel
    if scan:
        rates = keys.numbers("line_scan_rate", (None, 3)) - [1.0, 0.0, 0.0]
        model = LineScanModel(camera, orientation, rates, shape, axes_name)
    else:
        model = FrameModel(camera, ConstantOrientation(position, rotation), shape, axes_name)
    platform, sensor = keys.text("name_platform", ""), keys.text("name_sensor", "")
    return SupportData(model, radius_m, epoch, sun_m, platform, sensor)


def _camera(keys: Keys, scan: bool, down: Floats) -> Camera:
    """Return the interior orientation; `down` points to the Moon's centre in the camera's axes."""
    to_pixel = np.array([keys.numbers(f"focal2pixel_{axis}s", (3,)) for axis in _PIXEL_AXES])
    summing = np.array([keys.number(f"detector_{axis}_summing", 1.0) for axis in _PIXEL_AXES])
    start = np.array([keys.number(f"starting_detector_{axis}", 0.0) for axis in _PIXEL_AXES])
    centre = np.array([keys.number(f"detector_center.{axis}") for axis in _PIXEL_AXES])
    first = np.array([_CSM_CENTRE, 0.0 if scan else _CSM_CENTRE])  # a line scan's detector is its line 0
    if not ((summing >= _SUMMING_LIMITS[0]) & (summing <= _SUMMING_LIMITS[1])).all():
        problem = (
            "expected detector_sample_summing and detector_line_summing from {:g} to {:g}, got {:g} and {:g}"
        )
        raise FileFormatError(keys.path, problem.format(*_SUMMING_LIMITS, *summing))
    return Camera(
        keys.number("focal_length_model.focal_length"),
        to_pixel[:, 1:] / summing[:, None],
        (centre + to_pixel[:, 0] - start) / summing - first,
        _distortion(keys),
        1 if down[2] > 0.0 else -1,
    )


def _distortion(keys: Keys) -> Distortion:
    content = keys.get("optical_distortion", {})
    kind, parameters = next(iter(content.items())) if isinstance(content, dict) and content else ("", {})
    kind = str(kind).lower()
    supported = [name for name in KINDS if name not in ("none", "brown")]
    if kind not in supported or len(content) > 1:
        raise FileFormatError(
            keys.path, f"optical_distortion: expected one of {', '.join(supported)}, got {kind!r}"
        )
    values = Keys(keys.path, parameters)
    if kind != "kaguyalism":
        return Distortion(kind, values.numbers("coefficients", (None,)).tolist())
    x, y = ([values.number(f"boresight_{axis}"), *values.numbers(axis, (4,))] for axis in "xy")
    return Distortion(kind, x + y)


def _times(keys: Keys, name: str, epoch: float) -> Floats:
    """Return the times of a table since the epoch, s."""
    times = keys.numbers(f"{name}.ephemeris_times", (None,)) - epoch
    if not len(times) or (np.diff(times) <= 0.0).any() or np.abs(times).max() > _MAX_FROM_EPOCH_S:
        raise FileFormatError(
            keys.path,
            f"expected rising times in {name}.ephemeris_times within {_MAX_FROM_EPOCH_S:.0f} s of "
            f"center_ephemeris_time, got {len(times)} from {times.min(initial=np.inf):g} to "
            f"{times.max(initial=-np.inf):g} s",
        )
    return times


def _rotations(keys: Keys, name: str) -> Floats:
    """Return rotations from J2000, with the constant rotation, at the times of a table, shape (n, 3, 3)."""
    times = keys.numbers(f"{name}.ephemeris_times", (None,))
    quaternions = keys.numbers(f"{name}.quaternions", (len(times), 4))
    if (np.abs(np.linalg.norm(quaternions, axis=1) - 1.0) > 1e-3).any():
        raise FileFormatError(keys.path, f"{name}.quaternions: expected unit length")
    constant = keys.numbers(f"{name}.constant_rotation", (9,), np.eye(3).ravel()).reshape(3, 3)
    return constant @ matrices_from_quaternions(quaternions)


def _states(
    keys: Keys, name: str, epoch: float, rot_j2000_to_moon: Any
) -> tuple[Floats, Floats, Floats | None]:
    """Return times since the epoch, s, positions, m, and velocities relative to the Moon's axes, m/s."""
    scale = _unit_m(keys, f"{name}.unit")
    times = _times(keys, name, epoch)
    positions = keys.numbers(f"{name}.positions", (len(times), 3)) * scale
    turned = rot_j2000_to_moon(times)
    if not keys.has(f"{name}.velocities"):
        return times, vectors.rotated(turned, positions), None
    velocities = keys.numbers(f"{name}.velocities", (len(times), 3)) * scale
    # The axes turn evenly enough for a difference over two milliseconds; a table may end at the first or last time.
    change = rot_j2000_to_moon(times + _STATE_STEP_S) - rot_j2000_to_moon(times - _STATE_STEP_S)
    rotation_rate = change / (2 * _STATE_STEP_S)
    relative = vectors.rotated(turned, velocities) + vectors.rotated(rotation_rate, positions)
    return times, vectors.rotated(turned, positions), relative


def _unit_m(keys: Keys, name: str) -> float:
    unit = keys.text(name, "km").lower()
    if unit not in _UNITS_M:
        raise FileFormatError(keys.path, f"{name}: expected m or km, got {unit!r}")
    return _UNITS_M[unit]
