"""Solutions for geographic information systems: points and error ellipses as GeoJSON or GeoPackage.

Coordinates are east longitude and latitude on the sphere of 1737.4 km, IAU_2015:30100; the axes are the solution's
mean-Earth axes, named in each feature.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from radioloc.constants import MEAN_LUNAR_RADIUS_M
from radioloc.lazy import optional
from radioloc.lunar.local import displaced
from radioloc.lunar.selenographic import cartesian_to_selenographic, east_north_up, selenographic_to_cartesian
from radioloc.results.tables import (
    SolutionLike,
    contents_by_target,
    horizontal_covariance_of,
    position_of,
    references_of,
)
from radioloc.text_files import require_ending, scratch_folder, write_blocks, write_text
from radioloc.vectors import Floats

CRS = "IAU_2015:30100"  # Longitude and latitude on the Moon's sphere, as PROJ and GDAL know it
_ELLIPSES = {"1 sigma": 1.0, "95 %": math.sqrt(-2.0 * math.log(0.05))}
_CORNERS = 90
_MAX_SEMI_MAJOR_M = 0.5 * math.pi * MEAN_LUNAR_RADIUS_M  # a quarter of a great circle


def write_gis(path: str | Path, solutions: Iterable[SolutionLike]) -> Path:
    """Write positions, error ellipses and references for QGIS and its like.

    Parameters
    ----------
    path : path-like
        ``.geojson``, or ``.gpkg``, which needs the extra ``gis`` (pyogrio). A GeoPackage has the layers ``positions``
        and ``ellipses``; GeoJSON has one layer whose property ``kind`` distinguishes them.
    solutions : iterable of Solution, other result with a position, or mapping
        Results to write; a mapping is the content of ``solution.json``.

    Raises
    ------
    InputError
        A solution has no position, the ending is another, or the extra is not installed.

    Examples
    --------
    >>> import radioloc
    >>> solution = radioloc.locate(radioloc.read_study("examples/apollo15/apollo15.toml"))
    >>> radioloc.io.write_gis("apollo15.geojson", [solution]).name
    'apollo15.geojson'
    """
    file, ending = Path(path), require_ending(path, (".geojson", ".gpkg"))
    layers = position_layers(solutions)
    if ending == ".geojson":
        lines = ",\n".join(map(json.dumps, chain(*layers.values())))
        write_text(file, json.dumps(_collection([])).replace("[]", f"[\n{lines}\n]") + "\n")
    else:
        write_geopackage(file, layers)
    return file


def position_layers(solutions: Iterable[SolutionLike]) -> dict[str, list[dict[str, Any]]]:
    """Return features of the layers ``positions`` and ``ellipses``."""
    contents = contents_by_target(solutions)
    ellipses = [ellipse for content in contents for ellipse in _ellipses(content)]
    return {"positions": _positions(contents), "ellipses": ellipses}


def _positions(contents: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return points of the solutions and of the references, each reference once."""
    points = []
    references = {}
    for content in contents:
        me = position_of(content)["me"]
        frame = {"frame": me["frame"], "height_m": me["height_m"]}
        sigmas = {f"sigma_{axis}_m": content["sigma"][f"{axis}_m"] for axis in ("east", "north", "up")}
        named = {"kind": content.get("method", "tracking"), "name": content["name"], **frame, **sigmas}
        place = (me["longitude_deg"], me["latitude_deg"])
        points.append(feature("Point", place, named | {"converged": content["converged"]}))
        for reference in references_of(content):
            place = (reference["longitude_deg"], reference["latitude_deg"])
            named = {
                "kind": "reference",
                "name": reference["name"],
                "frame": me["frame"],
                "height_m": reference["height_m"],
            }
            references[reference["name"], *place] = feature("Point", place, named)
    return [*points, *references.values()]


def _ellipses(content: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the horizontal error ellipses of a solution that is determined, not held and smaller than a hemisphere."""
    me = position_of(content)["me"]
    covariance = horizontal_covariance_of(content)
    if covariance is None or not covariance.any():
        return []
    longitude_rad, latitude_rad = math.radians(me["longitude_deg"]), math.radians(me["latitude_deg"])
    variances, axes = np.linalg.eigh(covariance)
    angles = np.linspace(0.0, 2.0 * np.pi, _CORNERS + 1)
    angles[-1] = 0.0  # a ring ends exactly where it begins
    circle = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    one_sigma_m = circle @ (axes * np.sqrt(np.maximum(variances, 0.0))).T
    centre_m = selenographic_to_cartesian(longitude_rad, latitude_rad, 0.0)
    to_enu = east_north_up(longitude_rad, latitude_rad)
    features = []
    for name, factor in _ELLIPSES.items():
        if factor * math.sqrt(variances[-1]) > _MAX_SEMI_MAJOR_M:
            continue
        along_m = np.column_stack([factor * one_sigma_m, np.zeros(len(circle))])
        ring = _ring(displaced(centre_m, along_m, to_enu), (me["longitude_deg"], me["latitude_deg"]))
        minor_m, major_m = (factor * np.sqrt(np.maximum(variances, 0.0))).tolist()
        named = {"kind": "ellipse", "name": f"{content['name']}, {name}", "frame": me["frame"]}
        sizes = {"semi_major_m": major_m, "semi_minor_m": minor_m}
        features.append(feature("Polygon", [ring], named | sizes))
    return features


def _ring(corners_m: Floats, centre_deg: tuple[float, float]) -> list[list[float]]:
    """Return longitudes and latitudes of a closed ring, each next to the one before, also across 180 degrees."""
    # A ring around a pole is not closed in longitude and latitude. It is cut at the meridian opposite to the centre and
    # continued along the pole, so that the polygon contains its centre.
    longitude_rad, latitude_rad, _ = cartesian_to_selenographic(corners_m)
    longitudes = np.unwrap(np.degrees(longitude_rad), period=360.0)
    longitudes += centre_deg[0] + math.remainder(longitudes[0] - centre_deg[0], 360.0) - longitudes[0]
    latitudes = np.degrees(latitude_rad)
    if abs(longitudes[-1] - longitudes[0]) > 180.0:
        west, east, pole = centre_deg[0] - 180.0, centre_deg[0] + 180.0, math.copysign(90.0, centre_deg[1])
        wrapped = west + (longitudes[:-1] - west) % 360.0
        order = np.argsort(wrapped)
        cut = np.interp(west, wrapped, latitudes[:-1], period=360.0)
        longitudes = np.concatenate([[west], wrapped[order], [east, east, west, west]])
        latitudes = np.concatenate([[cut], latitudes[:-1][order], [cut, pole, pole, cut]])
    return np.stack([longitudes, latitudes], axis=-1).tolist()


def feature(geometry: str, coordinates: object, properties: Mapping[str, Any]) -> dict[str, Any]:
    """Return a feature of GeoJSON."""
    place = {"type": geometry, "coordinates": coordinates}
    return {"type": "Feature", "properties": dict(properties), "geometry": place}


def _collection(features: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return features with the Moon's reference system as GDAL writes it; RFC 7946 alone would mean the Earth."""
    crs = {"type": "name", "properties": {"name": "urn:ogc:def:crs:IAU_2015::30100"}}
    return {"type": "FeatureCollection", "crs": crs, "features": list(features)}


def write_geopackage(file: Path, layers: Mapping[str, Sequence[Mapping[str, Any]]]) -> None:
    """Write features by layer; empty layers are left out."""
    raw = optional("pyogrio.raw", f"{file}: a GeoPackage needs pyogrio; write .geojson, or", "gis")
    with scratch_folder() as folder:
        layered = folder / "layers.gpkg"  # GDAL needs the ending
        for name, features in layers.items():
            if not features:
                continue
            content = json.dumps(_collection(features)).encode()
            meta, _, geometry, columns = raw.read(content)
            kind = {"driver": "GPKG", "geometry_type": meta["geometry_type"], "crs": CRS}
            raw.write(layered, geometry, columns, meta["fields"], layer=name, append=layered.exists(), **kind)
        write_blocks(file, [layered.read_bytes()])
