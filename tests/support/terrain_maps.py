"""Maps of an analytic lunar surface, in the projections and formats of lunar maps."""

import numpy as np
import rasterio
import rasterio.warp
from rasterio.crs import CRS
from rasterio.transform import Affine

from radioloc.constants import MEAN_LUNAR_RADIUS_M

R = MEAN_LUNAR_RADIUS_M
DEGREE_M = np.radians(R)
CELL_DEG = 0.5
CELL_M = CELL_DEG * DEGREE_M
LONGLAT = CRS.from_proj4(f"+proj=longlat +R={R} +no_defs")

# The surface below curves by at most 10 km/rad^2 and cells are 0.5 deg (0.0087 rad): bilinear interpolation errs by
# up to 0.0087^2 / 8 * 10 km along each axis; half a cell off would show as 5 to 15 m.
BILINEAR_M = 0.2
BICUBIC_M = 0.01
FLOAT32_M = 1e-3  # heights of 5 km as 32-bit floats


def surface_m(longitude_rad, latitude_rad):
    """Return a height with slopes everywhere, smooth across date line and poles: a polynomial of the unit vector."""
    x, y = np.cos(latitude_rad) * np.cos(longitude_rad), np.cos(latitude_rad) * np.sin(longitude_rad)
    z = np.sin(latitude_rad)
    return 1500.0 * x - 800.0 * z + 1000.0 * y + 3000.0 * x * y * z


def on_map(affine, u, v):
    """Return map coordinates of column u, row v, counted from the map's corner."""
    a, b, c, d, e, f = tuple(affine)[:6]
    return a * u + b * v + c, d * u + e * v + f


def heights_of_map(proj4, affine, rows, columns):
    """Return heights at the centres of the cells."""
    u, v = np.meshgrid(np.arange(columns) + 0.5, np.arange(rows) + 0.5)
    x, y = on_map(affine, u.ravel(), v.ravel())
    lon, lat = (np.radians(a) for a in rasterio.warp.transform(CRS.from_proj4(proj4), LONGLAT, x, y))
    return surface_m(lon, lat).reshape(rows, columns)


def write_raster(path, values, **profile):
    """Write one band or several as a GeoTIFF."""
    bands = values.reshape(-1, *values.shape[-2:])
    size = dict(zip(("count", "height", "width"), bands.shape, strict=True))
    with rasterio.open(path, "w", **({"driver": "GTiff", "dtype": bands.dtype} | size | profile)) as dataset:
        dataset.write(bands)
    return path


def write(path, heights, proj4, affine, driver="GTiff", dtype="float32", units="m", **tags):
    """Write heights as one band; ``nodata``, ``scale`` and ``offset`` are set as such, other keywords as tags."""
    rows, columns = heights.shape
    profile = {"driver": driver, "width": columns, "height": rows, "count": 1, "dtype": dtype}
    nodata = tags.pop("nodata", None)
    scale, offset = tags.pop("scale", None), tags.pop("offset", None)
    crs = None if proj4 is None else CRS.from_string(proj4)
    with rasterio.open(path, "w", crs=crs, transform=affine, nodata=nodata, **profile) as dataset:
        dataset.write(heights.astype(dtype), 1)
        if units:
            dataset.units = (units,)
        if scale is not None:
            dataset.scales, dataset.offsets = (scale,), (offset,)
        if tags:
            dataset.update_tags(**tags)
    return path


def degrees(*pairs):
    return tuple(np.radians(np.array(pairs, dtype=float)).T)


def grid_of_points(longitudes_deg, latitudes_deg):
    lon, lat = np.meshgrid(np.linspace(*longitudes_deg, 23), np.linspace(*latitudes_deg, 19))
    return np.radians(lon.ravel()), np.radians(lat.ravel())


GLOBE = grid_of_points((-360.0, 360.0), (-90.0, 90.0))
NORTH_UP = Affine(CELL_M, 0.0, -360 * CELL_M, 0.0, -CELL_M, 180 * CELL_M)
EQC = f"+proj=eqc +R={R}"
POLAR = Affine(CELL_M, 0.0, -40 * CELL_M, 0.0, -CELL_M, 40 * CELL_M)
COS_M, SIN_M = CELL_M * np.cos(0.4), CELL_M * np.sin(0.4)
ROTATED = Affine(COS_M, SIN_M, -40 * (COS_M + SIN_M), SIN_M, -COS_M, 40 * (COS_M - SIN_M))
MAPS = {
    "equirectangular, -180 to 180": (EQC, NORTH_UP, 360, 720, GLOBE),
    "equirectangular about 180": (EQC + " +lon_0=180", NORTH_UP, 360, 720, GLOBE),
    "equirectangular, 0 to 360": (EQC, Affine(CELL_M, 0.0, 0.0, 0.0, -CELL_M, 180 * CELL_M), 360, 720, GLOBE),
    "longitude and latitude, 0 to 360": (
        f"+proj=longlat +R={R}", Affine(0.5, 0, 0, 0, -0.5, 90), 360, 720, GLOBE,
    ),
    "centres on the poles, first column repeated": (
        f"+proj=longlat +R={R}", Affine(0.5, 0, -180.25, 0, -0.5, 90.25), 361, 721, GLOBE,
    ),
    "standard parallel 40, across the date line": (
        EQC + " +lat_ts=40 +lon_0=175",
        Affine(CELL_M, 0.0, -40 * CELL_M, 0.0, -CELL_M, 80 * CELL_M),
        60, 80, grid_of_points((160.0, 196.0), (12.0, 38.0)),
    ),
    "polar stereographic, north": (
        f"+proj=stere +lat_0=90 +lon_0=0 +R={R}", POLAR, 80, 80, grid_of_points((-180, 180), (72.0, 90.0)),
    ),
    "polar stereographic, south": (
        f"+proj=stere +lat_0=-90 +lon_0=30 +R={R}", POLAR, 80, 80, grid_of_points((-180, 180), (-90.0, -72.0)),
    ),
    "orthographic": (
        f"+proj=ortho +lat_0=20 +lon_0=-40 +R={R}", POLAR, 80, 80, grid_of_points((-54, -26), (6.0, 34.0)),
    ),
    "transverse Mercator": (
        f"+proj=tmerc +lat_0=0 +lon_0=23.5 +R={R}", POLAR, 80, 80, grid_of_points((8, 38), (-18.0, 18.0)),
    ),
    "Lambert conformal": (
        f"+proj=lcc +lat_1=30 +lat_2=50 +lat_0=40 +lon_0=100 +R={R}", POLAR, 80, 80,
        grid_of_points((88, 112), (32.0, 48.0)),
    ),
    "Mercator": (
        f"+proj=merc +R={R}", Affine(CELL_M, 0, -360 * CELL_M, 0, -CELL_M, 80 * CELL_M), 160, 720,
        grid_of_points((-360, 360), (-35.0, 35.0)),
    ),
    "rotated": (
        EQC, ROTATED, 80, 80, grid_of_points((-12, 12), (-12.0, 12.0)),
    ),
    "kilometres on the map": (
        f"+proj=stere +lat_0=90 +R={R} +units=km", Affine(*(v / 1e3 for v in tuple(POLAR)[:6])), 80, 80,
        grid_of_points((-180, 180), (72.0, 90.0)),
    ),
}  # fmt: skip


PDS3 = """PDS_VERSION_ID = PDS3
TARGET_NAME = {target}
OBJECT = UNCOMPRESSED_FILE
  FILE_NAME = "MAP.IMG"
  RECORD_TYPE = FIXED_LENGTH
  FILE_RECORDS = {lines}
  RECORD_BYTES = {bytes}
  ^IMAGE = "MAP.IMG"
  OBJECT = IMAGE
    NAME = HEIGHT
    LINES = {lines}
    LINE_SAMPLES = {samples}
    SAMPLE_TYPE = {type}
    SAMPLE_BITS = {bits}
    UNIT = {unit}
    SCALING_FACTOR = {scale}
    OFFSET = {offset}
  END_OBJECT = IMAGE
END_OBJECT = UNCOMPRESSED_FILE
OBJECT = IMAGE_MAP_PROJECTION
  MAP_PROJECTION_TYPE = "{projection}"
  A_AXIS_RADIUS = 1737.4 <km>
  B_AXIS_RADIUS = 1737.4 <km>
  C_AXIS_RADIUS = 1737.4 <km>
  POSITIVE_LONGITUDE_DIRECTION = "{sense}"
  CENTER_LATITUDE = {lat_0} <deg>
  CENTER_LONGITUDE = {lon_0} <deg>
  MAP_PROJECTION_ROTATION = 0.0
  MAP_SCALE = {map_scale}
  LINE_PROJECTION_OFFSET = {line_offset} <pix>
  SAMPLE_PROJECTION_OFFSET = {sample_offset} <pix>
  COORDINATE_SYSTEM_NAME = "{axes}"
END_OBJECT = IMAGE_MAP_PROJECTION
END
"""


def write_pds3(folder, heights_m, **changes):
    """Write a label and image like those of LOLA's gridded products (integers of 0.5 m above OFFSET)."""
    lines, samples = heights_m.shape
    label = {
        "target": "MOON", "lines": lines, "samples": samples, "bytes": 2 * samples, "type": "LSB_INTEGER", "bits": 16,
        "unit": "METER", "scale": 0.5, "offset": "1737400.", "sense": "EAST", "lat_0": 0, "lon_0": 180,
        "line_offset": lines / 2 - 0.5, "sample_offset": samples / 2 - 0.5, "axes": "MEAN EARTH/POLAR AXIS OF DE421",
    }  # fmt: skip
    label |= changes
    numbers = np.rint(heights_m / 0.5).astype("<i2")
    if label["unit"] == "KILOMETER":
        numbers = (heights_m / 1e3).astype("<f4")
    (folder / "MAP.IMG").write_bytes(numbers.tobytes())
    (folder / "MAP.LBL").write_text(PDS3.format(**label))
    return folder / "MAP.LBL"


SMALL = Affine(CELL_M, 0, -10 * CELL_M, 0, -CELL_M, 10 * CELL_M)
SLOPING = np.add.outer(np.arange(20) * 10.0, np.arange(20) * 30.0)
PLACE = degrees((1.1, 2.2))
PLACE_M = SLOPING[0, 0] + 10.0 * ((5.0 - 2.2) / 0.5 - 0.5) + 30.0 * ((5.0 + 1.1) / 0.5 - 0.5)  # a plane
