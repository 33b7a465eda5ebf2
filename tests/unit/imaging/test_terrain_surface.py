"""Intersections of rays with an elevation map: dense sampling, hidden ground, projections, seams, voids, partials."""

from dataclasses import replace

import numpy as np
import pytest
import terrain_maps
from ldem import write_ldem_4
from quick import each_with_one
from rasterio.transform import Affine

from radioloc.errors import InputError
from radioloc.imaging import Camera, ConstantOrientation, FrameModel, Sphere, Terrain
from radioloc.imaging.ground_points import image_to_ground, image_to_ground_and_partials
from radioloc.imaging.orientation import rotation_matrices
from radioloc.lunar import TerrainModel, cartesian_to_selenographic, east_north_up, selenographic_to_cartesian

R_M = 1737400.0
ON_GROUND_M = 1e-4  # the search ends at 0.01 mm


def write_hills(path, cell_m=20.0, size=500, void=False):
    """Write hills of 150 m and rough ground around longitude and latitude zero."""
    steps_m = (np.arange(size) - (size - 1) / 2) * cell_m
    east, north = np.meshgrid(steps_m, -steps_m)
    heights = 150.0 * np.cos(east / 500.0) * np.cos(north / 400.0) + 0.02 * east
    heights += np.random.default_rng(8).normal(0.0, 2.0, size=heights.shape)
    if void:
        heights[240:260, 240:260] = -32768.0
    half_m = size * cell_m / 2
    affine = Affine(cell_m, 0.0, -half_m, 0.0, -cell_m, half_m)
    return terrain_maps.write(path, heights, terrain_maps.EQC, affine, nodata=-32768.0)


@pytest.fixture(scope="module")
def hills(tmp_path_factory):
    return write_hills(tmp_path_factory.mktemp("dem") / "hills.tif")


def camera_above(height_m, off_nadir_deg, shape=(400, 400), field_deg=20.0):
    camera = Camera.of_pinhole(
        10.0, 20.0 * np.tan(np.radians(field_deg / 2)) / shape[0] * 1e3, [199.5, 199.5]
    )
    down = np.array([[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    tilt = rotation_matrices(np.radians([[off_nadir_deg, 0.0, 0.0]]))[0]
    place = ConstantOrientation([R_M + height_m, 0.0, 0.0], down @ tilt)
    return FrameModel(camera, place, shape)


def first_by_sampling(terrain, origin, direction, top_m, step_m, until_m):
    """Return the distance of the first sample under the terrain."""
    distance = np.arange(0.0, until_m, step_m)
    points = origin + distance[:, None] * direction
    longitude, latitude, height_m = cartesian_to_selenographic(points)
    low = height_m < top_m
    under = np.zeros(len(points), dtype=bool)
    under[low] = height_m[low] < terrain.height_m(longitude[low], latitude[low])
    return distance[np.argmax(under)]


VIEWS = [(5e3, 0.0), (1.5e3, 45.0), (400.0, 78.0)]


@pytest.mark.study
@pytest.mark.parametrize(("view", "interpolation"), each_with_one(VIEWS, VIEWS, ["bilinear", "bicubic"]))
def test_first_intersection_is_that_of_dense_sampling(hills, view, interpolation):
    """Include rays at 2 degrees above the horizon, with ground hidden by hills."""
    height_m, off_nadir_deg = view
    terrain = TerrainModel.open(hills, interpolation=interpolation)
    model = camera_above(height_m, off_nadir_deg)
    pixels = np.random.default_rng(9).uniform([0.0, 40.0], [399.0, 399.0], size=(60, 2))
    rays = model.rays(pixels)
    points, hits = Terrain(terrain).intersect(rays.origins_m, rays.directions)
    assert hits.all() or (off_nadir_deg > 70.0 and hits.mean() > 0.9)  # some rays leave the map
    longitude, latitude, height_m = cartesian_to_selenographic(points[hits])
    assert np.abs(height_m - terrain.height_m(longitude, latitude)).max() < ON_GROUND_M
    step_m = 0.5
    for origin, direction, point in zip(
        rays.origins_m[hits][:25], rays.directions[hits], points[hits], strict=False
    ):
        distance = np.linalg.norm(point - origin)
        sampled = first_by_sampling(terrain, origin, direction, 400.0, step_m, distance + 20 * step_m)
        assert distance <= sampled + ON_GROUND_M
        # Sampling misses ridges thinner than its step.
        assert sampled - distance < step_m + ON_GROUND_M or off_nadir_deg > 70.0


@pytest.mark.parametrize("name", terrain_maps.MAPS)
def test_intersections_have_the_height_of_the_map_in_each_projection(tmp_path, name):
    proj4, affine, rows, columns, (longitude, latitude) = terrain_maps.MAPS[name]
    heights = terrain_maps.heights_of_map(proj4, affine, rows, columns)
    terrain = TerrainModel.open(terrain_maps.write(tmp_path / "map.tif", heights, proj4, affine))
    near_pole = np.abs(latitude) > np.radians(89.0)
    longitude, latitude = longitude[~near_pole], latitude[~near_pole]
    east, north, up = np.moveaxis(east_north_up(longitude, latitude), 1, 0)
    toward = -up + 0.15 * east - 0.1 * north
    toward /= np.linalg.norm(toward, axis=1)[:, None]
    origins = selenographic_to_cartesian(longitude, latitude, 0.0) - 6e4 * toward
    points, hits = Terrain(terrain).intersect(origins, toward)
    assert hits.mean() > 0.9
    hit_longitude, hit_latitude, hit_m = cartesian_to_selenographic(points[hits])
    assert np.abs(hit_m - terrain.height_m(hit_longitude, hit_latitude)).max() < ON_GROUND_M
    off_m = np.linalg.norm(np.cross(points[hits] - origins[hits], toward[hits]), axis=1)
    assert off_m.max() < ON_GROUND_M


@pytest.mark.parametrize("interpolation", ["bilinear", "bicubic"])
def test_partials_on_hills(hills, interpolation):
    terrain = Terrain(TerrainModel.open(hills, interpolation=interpolation))
    model = camera_above(3e3, 30.0)
    pixels = np.random.default_rng(11).uniform(50.0, 350.0, size=(40, 2))
    ground = image_to_ground_and_partials(model, pixels, terrain)

    def close(partials, change, step):
        slope = (change(step) - change(-step)) / (2 * step)
        # Partials of bilinear ground jump at the edges of cells, near few of the points.
        error = np.abs(partials - slope).max(axis=1) / np.abs(slope).max()
        assert np.median(error) < 1e-5
        assert (error < 1e-4).mean() >= (0.9 if interpolation == "bilinear" else 1.0)

    for k in range(2):
        axis = np.eye(2)[k]
        close(
            ground.by_pixel[:, :, k],
            lambda h, axis=axis: image_to_ground(model, pixels + h * axis, terrain),
            1e-2,
        )
    place = model.orientation

    def moved(shift_m):
        orientation = replace(place, position_m=place.position_m + shift_m)
        return image_to_ground(replace(model, orientation=orientation), pixels, terrain)

    for k in range(3):
        axis = np.eye(3)[k]
        close(ground.by_position[:, :, k], lambda h, axis=axis: moved(h * axis), 0.1)
    close(ground.by_height, lambda h: image_to_ground(model, pixels, replace(terrain, raised_m=h)), 0.1)


@pytest.fixture(scope="module")
def ldem_4(tmp_path_factory):
    return TerrainModel.open(write_ldem_4(tmp_path_factory.mktemp("ldem")))


def test_across_the_seam_of_a_global_map(ldem_4):
    longitude = np.radians([179.9, -179.9, 179.99, 0.1])
    latitude = np.radians([10.0, 10.2, 9.8, 10.0])
    ground = selenographic_to_cartesian(longitude, latitude, ldem_4.height_m(longitude, latitude))
    up = east_north_up(longitude, latitude)[:, 2]
    for rows in (slice(0, 3), slice(0, 4)):  # a window over the seam, and one all around
        points, hits = Terrain(ldem_4).intersect(ground[rows] + 1e5 * up[rows], -up[rows])
        assert hits.all()
        assert np.linalg.norm(points - ground[rows], axis=1).max() < ON_GROUND_M


def test_rays_that_leave_the_map_or_end_in_a_void_do_not_meet_the_ground(tmp_path, hills):
    model = camera_above(3e3, 0.0)
    terrain = Terrain(TerrainModel.open(write_hills(tmp_path / "void.tif", void=True)))
    rays = model.rays([[199.5, 199.5], [20.0, 20.0]])
    assert terrain.intersect(rays.origins_m, rays.directions)[1].tolist() == [False, True]
    with pytest.raises(InputError, match=r"sample 199\.5, line 199\.5"):
        image_to_ground(model, [[199.5, 199.5], [20.0, 20.0]], terrain)
    over_edge = camera_above(3e3, 75.0)
    rays = over_edge.rays([[199.5, 10.0]])
    assert not Terrain(TerrainModel.open(hills)).intersect(rays.origins_m, rays.directions)[1].any()
    opposite = camera_above(3e3, 0.0).rays([[199.5, 199.5]])
    assert not Terrain(TerrainModel.open(hills)).intersect(-opposite.origins_m, -opposite.directions)[1].any()


@pytest.mark.study
def test_large_windows_are_split(monkeypatch, hills):
    terrain = TerrainModel.open(hills)
    model = camera_above(3e3, 60.0)
    rays = model.rays(np.random.default_rng(14).uniform(0.0, 399.0, size=(40, 2)))
    points, hits = Terrain(terrain).intersect(rays.origins_m, rays.directions)
    monkeypatch.setattr("radioloc.lunar.terrain._MAX_WINDOW_CELLS", 3000)
    with pytest.raises(InputError, match="up to 3000 cells"):
        terrain.window(np.array([-0.002, 0.002]), np.array([-0.002, 0.002]))
    # Rays are halved in number, then in length.
    by_parts, part_hits = Terrain(terrain).intersect(rays.origins_m, rays.directions)
    assert (part_hits == hits).all()
    assert hits.mean() > 0.5
    assert np.linalg.norm(by_parts - points, axis=1).max() < 2 * ON_GROUND_M
    gradient = Terrain(terrain).gradient(points[hits])
    monkeypatch.undo()
    assert np.abs(Terrain(terrain).gradient(points[hits]) - gradient).max() < 1e-9


def test_elevation_maps_need_mean_earth_axes(hills):
    model = replace(camera_above(3e3, 0.0), axes="IAU_MOON")
    with pytest.raises(InputError, match="got IAU_MOON"):
        image_to_ground(model, [[199.5, 199.5]], Terrain(TerrainModel.open(hills)))
    assert len(image_to_ground(model, [[199.5, 199.5]], Sphere())) == 1
