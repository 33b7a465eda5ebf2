"""Locating a point that is measured in one image."""

from __future__ import annotations

import math
from contextlib import suppress

import numpy as np

from radioloc.constants import MEAN_LUNAR_RADIUS_M
from radioloc.errors import CoverageError
from radioloc.imaging import ImagePointSigmas, LineScanModel, Sphere, Terrain, locate_image_point, read_isd
from radioloc.lunar import TerrainModel
from radioloc.report.cards import Field
from radioloc.report.point_solution import ErrorSource, PointSolution
from radioloc.studies.image_inputs import FRAME, provenance_of
from radioloc.studies.image_study import ImagePointChoice, PointStudy
from radioloc.time import Epochs, to_scale, utc_strings


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
    emission_deg = math.degrees(math.acos(float(-rays.directions[0] @ up)))
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
