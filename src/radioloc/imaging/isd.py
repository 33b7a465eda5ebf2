"""Image support data of USGS (ISD, JSON): sensor models of images.

The files are those that ALE writes and the Community Sensor Models of USGS (``usgscsm``) read. Their pixels have 0.5 at
the centre of the first one, samples, lines and a detector's centre alike; half a pixel is taken off here. Lengths are
kilometres, on the focal plane millimetres; epochs are TDB seconds since J2000; quaternions and constant rotations turn
vectors from J2000 to the camera or the Moon.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from radioloc import vectors
from radioloc.ephemeris.orientation import LUNAR_AXES
from radioloc.errors import DataQualityWarning, FileFormatError, InputError, in_file
from radioloc.imaging.cameras import Camera
from radioloc.imaging.distortion import KINDS, Distortion
from radioloc.imaging.labels import Keys, is_isis_cube, isd_of_cube
from radioloc.imaging.orientation import (
    ConstantOrientation,
    TabulatedOrientation,
    matrices_of,
    quaternions_of,
    slerp,
)
from radioloc.imaging.sensor_models import FrameModel, LineScanModel
from radioloc.lunar.frames import rot_icrf_to_me
from radioloc.text_files import json_file
from radioloc.time import Epochs
from radioloc.vectors import Floats

_FRAME, _LINE_SCAN = "USGS_ASTRO_FRAME_SENSOR_MODEL", "USGS_ASTRO_LINE_SCANNER_SENSOR_MODEL"
_UNITS_M = {"m": 1.0, "km": 1e3}
_SUMMING_LIMITS = 1e-3, 1e4  # pixels of the detector in one of the image
_CSM_CENTRE = 0.5  # of the first pixel
_AXES = {code: axes.frame for code, axes in LUNAR_AXES.items()} | {10020: "IAU_MOON"}  # axes by NAIF's code

MAX_FROM_EPOCH_S = 86400.0
"""Largest distance of an image's tables from its middle: line-scan images take seconds to minutes."""

_STATE_STEP_S = 1e-3
_NOT_SUPPORT_DATA = "expected the JSON of an ISD or an ISIS cube, got neither; make the file again"


@dataclass(frozen=True, slots=True, eq=False)
class SupportData:
    """What an ISD says of one image."""

    model: FrameModel | LineScanModel
    radius_m: float  # of the sphere that the ISD has for the Moon
    epoch_tdb_s: float  # TDB seconds since J2000, from which the model's times count
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
        ``"ME_DE421"`` turns from J2000 to the Moon by the lunar orientation of DE421 instead of by the file's own
        rotation: for files in axes that maps are not in, such as the IAU's mean rotation, up to 155 m away.

    Raises
    ------
    FileFormatError
        No such file, neither JSON nor a cube, a key that is missing or has no usable value (it is named), another kind
        of sensor.

    Examples
    --------
    >>> from radioloc.imaging import read_isd  # doctest: +SKIP
    >>> read_isd("M102128467LE.json").model.axes  # doctest: +SKIP
    'ME_DE421'
    """
    if axes not in (None, "ME_DE421"):
        raise InputError(f"axes = {axes!r} is not known; use 'ME_DE421', or leave it out for the file's own")
    if is_isis_cube(path):
        keys = Keys(path, isd_of_cube(path))
    else:
        with json_file(path, _NOT_SUPPORT_DATA) as content:
            keys = Keys(path, content)
    name = keys.text("name_model")
    if name not in (_FRAME, _LINE_SCAN):
        raise FileFormatError(path, f"name_model is {name!r}; {_FRAME} and {_LINE_SCAN} are read")
    with in_file(path):
        data = _support_data(keys, name == _LINE_SCAN, axes)
    return data


def _support_data(keys: Keys, scan: bool, axes: str | None) -> SupportData:
    epoch = keys.number("center_ephemeris_time")
    shape = (keys.count("image_lines"), keys.count("image_samples"))
    radius_m = keys.number("radii.semimajor") * _unit_m(keys, "radii.unit")
    if abs(keys.number("radii.semiminor") * _unit_m(keys, "radii.unit") - radius_m) > 1.0:
        raise FileFormatError(keys.path, "radii are those of an ellipsoid; the Moon is taken as a sphere")
    turns = _times(keys, "body_rotation", epoch)
    to_moon = _rotations(keys, "body_rotation")

    def rot_j2000_to_moon(times_s: Floats) -> Floats:
        if axes is not None:
            return rot_icrf_to_me(Epochs.from_tdb_seconds(np.full(len(times_s), epoch)).shifted(times_s))
        return slerp(turns, to_moon, times_s)

    frames = [
        int(code)
        for part in ("constant_frames", "time_dependent_frames")
        for code in keys.numbers(f"body_rotation.{part}", (None,), [])
    ]
    named = axes or (_AXES.get(frames[0], f"NAIF_{frames[0]}") if frames else "unknown")
    position_times, positions, velocities = _states(keys, "instrument_position", epoch, rot_j2000_to_moon)
    pointing_times = _times(keys, "instrument_pointing", epoch)
    to_camera = _rotations(keys, "instrument_pointing")
    rotations = rot_j2000_to_moon(pointing_times) @ np.swapaxes(to_camera, 1, 2)
    sun_m = None
    if keys.has("sun_position"):
        sun_times, sun, _ = _states(keys, "sun_position", epoch, rot_j2000_to_moon)
        sun_m = np.array([np.interp(0.0, sun_times, component) for component in sun.T])
    about = (radius_m, epoch, sun_m, keys.text("name_platform", ""), keys.text("name_sensor", ""))
    orientation: ConstantOrientation | TabulatedOrientation
    if len(position_times) == len(pointing_times) == 1:
        orientation = ConstantOrientation(positions[0], rotations[0])
    else:
        table = (position_times, positions, pointing_times, quaternions_of(rotations), velocities)
        orientation = TabulatedOrientation(*table)
    middle = np.array([0.0 if not scan else 0.5 * sum(orientation.span_s)])
    [position], [rotation] = orientation.at(middle)
    camera = _camera(keys, scan, -position @ rotation)
    if not scan:
        return SupportData(FrameModel(camera, ConstantOrientation(position, rotation), shape, named), *about)
    rates = keys.numbers("line_scan_rate", (None, 3)) - [1.0, 0.0, 0.0]
    return SupportData(LineScanModel(camera, orientation, rates, shape, named), *about)


def _camera(keys: Keys, scan: bool, down: Floats) -> Camera:
    """Return the interior orientation; `down` points to the Moon's centre in the camera's axes."""
    by_sample = keys.numbers("focal2pixel_samples", (3,))
    by_line = keys.numbers("focal2pixel_lines", (3,))
    summing = np.array(
        [keys.number("detector_sample_summing", 1.0), keys.number("detector_line_summing", 1.0)]
    )
    start = np.array(
        [keys.number("starting_detector_sample", 0.0), keys.number("starting_detector_line", 0.0)]
    )
    centre = np.array([keys.number("detector_center.sample"), keys.number("detector_center.line")])
    first = np.array([_CSM_CENTRE, 0.0 if scan else _CSM_CENTRE])  # a line scan's detector is its line 0
    if not ((summing >= _SUMMING_LIMITS[0]) & (summing <= _SUMMING_LIMITS[1])).all():
        problem = (
            "expected detector_sample_summing and detector_line_summing from {:g} to {:g}, got {:g} and {:g}"
        )
        raise FileFormatError(keys.path, problem.format(*_SUMMING_LIMITS, *summing))
    return Camera(
        keys.number("focal_length_model.focal_length"),
        np.array([by_sample[1:], by_line[1:]]) / summing[:, None],
        (centre + np.array([by_sample[0], by_line[0]]) - start) / summing - first,
        _distortion(keys),
        1 if down[2] > 0.0 else -1,
    )


def _distortion(keys: Keys) -> Distortion:
    kinds = keys.get("optical_distortion", {})
    if not isinstance(kinds, dict) or len(kinds) != 1:
        raise FileFormatError(keys.path, "optical_distortion does not name one kind")
    [(kind, about)] = kinds.items()
    kind = str(kind).lower()
    if kind not in KINDS or kind in ("none", "brown"):
        known = ", ".join(one for one in KINDS if one not in ("none", "brown"))
        raise FileFormatError(keys.path, f"optical_distortion is of the kind {kind!r}; {known} are read")
    inside = Keys(keys.path, about)
    if kind == "transverse":
        values: Sequence[float] = [*inside.numbers("x", (10,)), *inside.numbers("y", (10,))]
    elif kind == "kaguyalism":
        boresight = [[inside.number(f"boresight_{axis}")] for axis in "xy"]
        x, y = (inside.numbers(axis, (4,)) for axis in "xy")
        values = [*boresight[0], *x, *boresight[1], *y]
    else:
        values = inside.numbers("coefficients", (None,)).tolist()
    distortion = Distortion(kind, values)
    if not distortion.measured(np.zeros((1, 2)))[2].all():
        # USGS's model, too, takes image to ground without such a distortion.
        warnings.warn(
            f"{keys.path}: the distortion {kind!r} sends different rays to one point, as no lens does; it is left out",
            DataQualityWarning,
            stacklevel=2,
        )
        return Distortion("none", ())
    return distortion


def _times(keys: Keys, name: str, epoch: float) -> Floats:
    """Times of a table from the epoch, s."""
    times = keys.numbers(f"{name}.ephemeris_times", (None,)) - epoch
    if not len(times) or (np.diff(times) <= 0.0).any() or np.abs(times).max() > MAX_FROM_EPOCH_S:
        raise FileFormatError(
            keys.path,
            f"expected rising times in {name}.ephemeris_times within {MAX_FROM_EPOCH_S:.0f} s of "
            f"center_ephemeris_time, got {len(times)} from {times.min(initial=np.inf):g} to "
            f"{times.max(initial=-np.inf):g} s",
        )
    return times


def _rotations(keys: Keys, name: str) -> Floats:
    """Rotations from J2000 at a table's times, the constant one included, shape (n, 3, 3)."""
    times = keys.numbers(f"{name}.ephemeris_times", (None,))
    quaternions = keys.numbers(f"{name}.quaternions", (len(times), 4))
    if (np.abs(np.linalg.norm(quaternions, axis=1) - 1.0) > 1e-3).any():
        raise FileFormatError(keys.path, f"{name}.quaternions has one of another length than 1")
    constant = keys.numbers(f"{name}.constant_rotation", (9,), np.eye(3).ravel()).reshape(3, 3)
    return constant @ matrices_of(quaternions)


def _states(
    keys: Keys, name: str, epoch: float, rot_j2000_to_moon: Any
) -> tuple[Floats, Floats, Floats | None]:
    """Times from the epoch, positions, m, and velocities relative to the Moon's axes, m/s."""
    scale = _unit_m(keys, f"{name}.unit")
    times = _times(keys, name, epoch)
    positions = keys.numbers(f"{name}.positions", (len(times), 3)) * scale
    turned = rot_j2000_to_moon(times)
    if not keys.has(f"{name}.velocities"):
        return times, vectors.rotated(turned, positions), None
    velocities = keys.numbers(f"{name}.velocities", (len(times), 3)) * scale
    # The axes turn evenly enough for a difference over two milliseconds; a table may end at the first or last time.
    turning = (rot_j2000_to_moon(times + _STATE_STEP_S) - rot_j2000_to_moon(times - _STATE_STEP_S)) / (
        2 * _STATE_STEP_S
    )
    relative = vectors.rotated(turned, velocities) + vectors.rotated(turning, positions)
    return times, vectors.rotated(turned, positions), relative


def _unit_m(keys: Keys, name: str) -> float:
    unit = keys.text(name, "km").lower()
    if unit not in _UNITS_M:
        raise FileFormatError(keys.path, f"{name} is {unit!r}; m and km are read")
    return _UNITS_M[unit]
