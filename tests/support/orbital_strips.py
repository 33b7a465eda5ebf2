"""Line-scan images of procedural ground with errors of position and attitude, as image support data."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rasterio
from procedural_ground import Ground

from radioloc.imaging import Camera, LineScanModel, TabulatedOrientation, Terrain
from radioloc.imaging.frames import load_opencv
from radioloc.imaging.ground_points import image_to_ground
from radioloc.imaging.orientation import quaternions_from_matrices, rotation_matrices
from radioloc.imaging.shading import sun_direction
from radioloc.lunar import Map, TangentPlane, TerrainModel, cartesian_to_selenographic, east_north_up

HEIGHT_M, SPEED_M_S = 100e3, 1600.0
EPOCH_TDB_S = 6.6e8
_NODE_PX = 1


@dataclass(frozen=True)
class Strips:
    """Images in rows and columns, with the drawn errors of their support data."""

    columns: int
    rows: int
    shape: tuple[int, int]  # lines and samples
    pixel_m: float
    seed: int = 1
    overlap: float = 0.3
    position_sigma_m: tuple[float, float, float] = (100.0, 100.0, 30.0)
    position_drift_m: tuple[float, float, float] = (15.0, 15.0, 5.0)
    attitude_sigma_rad: tuple[float, float, float] = (1e-4, 1e-4, 1e-4)
    attitude_drift_rad: tuple[float, float, float] = (3e-5, 3e-5, 3e-5)
    plane: TangentPlane = TangentPlane(-51.9162, 43.0584)  # noqa: RUF009

    @property
    def sigmas(self):
        """Sigmas of the twelve corrections."""
        parts = (
            self.position_sigma_m, self.attitude_sigma_rad, self.position_drift_m, self.attitude_drift_rad
        )  # fmt: skip
        return np.concatenate(parts)

    def model(self, k, errors=None):
        """Return the sensor model of an image that flies north; `errors` are those of twelve corrections."""
        errors = np.zeros(12) if errors is None else errors
        lines, samples = self.shape
        step_m = self.pixel_m * (1.0 - self.overlap)
        row, column = divmod(k, self.columns)
        east_m = (column - 0.5 * (self.columns - 1)) * step_m * samples
        north_m = (row - 0.5 * (self.rows - 1)) * step_m * lines
        [(longitude, latitude)] = self.plane.to_longitude_latitude([[east_m, north_m]])
        east, north, up = east_north_up(*np.radians([longitude, latitude]))
        line_s = self.pixel_m / SPEED_M_S * (1.0 + HEIGHT_M / 1737400.0)
        half_s = 0.5 * lines * line_s
        times = np.linspace(-half_s - 0.5, half_s + 0.5, 31)
        radius_m = 1737400.0 - 2550.0 + HEIGHT_M
        angle = SPEED_M_S / radius_m * times[:, None]
        zenith = np.cos(angle) * up + np.sin(angle) * north
        part = times[:, None] / half_s
        offset, drift = errors.reshape(2, 2, 3)
        positions = radius_m * zenith + (offset[0] + part * drift[0]) @ np.array([east, north, up])
        # Columns: the camera's x to the east, y against the motion, z down.
        ahead = np.cos(angle) * north - np.sin(angle) * up
        rotations = np.stack([np.broadcast_to(east, ahead.shape), -ahead, -zenith], axis=-1)
        rotations = rotations @ rotation_matrices(offset[1] + part * drift[1])
        focal_mm = 700.0
        per_mm = HEIGHT_M / (self.pixel_m * focal_mm)
        camera = Camera(focal_mm, per_mm * np.eye(2), np.array([0.5 * (samples - 1), 0.0]))
        orientation = TabulatedOrientation(times, positions, times, quaternions_from_matrices(rotations))
        return LineScanModel(camera, orientation, [[-0.5, -half_s, line_s]], self.shape)

    def drawn_errors(self):
        """Return the errors of the support data of all images, shape (images, 12)."""
        rng = np.random.default_rng(self.seed)
        return rng.normal(size=(self.columns * self.rows, 12)) * self.sigmas

    def write(self, folder):
        """Write ``dem.tif``, images, their support data and ``strips.toml``; return true models."""
        cv2 = load_opencv()
        folder = Path(folder)
        ground = Ground(self.plane, seed=self.seed, level_m=-2550.0)
        lines, samples = self.shape
        width_m = 1.2 * self.pixel_m * max(samples * self.columns, lines * self.rows) + 1500.0
        ground.write_heights(folder / "dem.tif", 5.0 * self.pixel_m, width_m)
        ground.write_map(folder / "light.tif", self.pixel_m, width_m, sun_direction(100.0, 35.0), noise=0.0)
        light = Map.open(folder / "light.tif")
        with rasterio.open(folder / "light.tif") as file:
            values = file.read(1).astype(np.float32)
        terrain = Terrain(TerrainModel.open(folder / "dem.tif"))
        nodes = np.stack(
            np.meshgrid(*(np.linspace(0.0, n - 1.0, n // _NODE_PX) for n in (samples, lines))), axis=-1
        )
        rng = np.random.default_rng(self.seed + 1)
        truth = []
        for k, errors in enumerate(self.drawn_errors()):
            model = self.model(k)
            points = image_to_ground(model, nodes.reshape(-1, 2), terrain)
            longitude, latitude, _ = cartesian_to_selenographic(points)
            cells = light.pixels(np.degrees(np.column_stack([longitude, latitude]))).reshape(nodes.shape)
            at = np.meshgrid(
                *(
                    np.linspace(0.0, size - 1.0, n)
                    for size, n in zip(nodes.shape[1::-1], (samples, lines), strict=True)
                )
            )
            at = [axis.astype(np.float32) for axis in at]
            place = [cv2.remap(cells[..., c].astype(np.float32), *at, cv2.INTER_LINEAR) for c in (0, 1)]
            shown = cv2.remap(values, *place, cv2.INTER_CUBIC)
            # Exposure, and a slow change of brightness across the image.
            x = np.linspace(-1.0, 1.0, samples)
            shown = shown * rng.uniform(0.8, 1.25) * np.exp(rng.uniform(-0.06, 0.06) * x)
            shown = np.clip(np.rint(shown + rng.normal(0.0, 1.5, self.shape)), 1, 255).astype(np.uint8)
            cv2.imwrite(str(folder / f"strip{k:02d}.png"), shown)
            (folder / f"strip{k:02d}.json").write_text(json.dumps(_support_data(self.model(k, errors))))
            truth.append(model)
        (folder / "light.tif").unlink()
        (folder / "strips.toml").write_text(self._study())
        return truth

    def _study(self):
        return f"""[base_map]
images = ["strip*.png"]
models = ["strip*.json"]
dem = "dem.tif"
dem_sigma_m = 1.0
resolution_m = {self.pixel_m}
projection = "+proj=eqc +lat_ts={self.plane.latitude_deg} +lon_0={self.plane.longitude_deg} +R=1737400 +units=m"
position_sigma_m = {list(self.position_sigma_m)}
position_drift_m = {list(self.position_drift_m)}
attitude_sigma_rad = {list(self.attitude_sigma_rad)}
attitude_drift_rad = {list(self.attitude_drift_rad)}
"""


def _support_data(model):
    """Return image support data in the Moon's axes, with 0.5 at the centre of the first pixel."""
    camera, table = model.camera, model.orientation
    return {
        "name_model": "USGS_ASTRO_LINE_SCANNER_SENSOR_MODEL",
        "image_lines": model.shape[0],
        "image_samples": model.shape[1],
        "center_ephemeris_time": EPOCH_TDB_S,
        "radii": {"semimajor": 1737.4, "semiminor": 1737.4, "unit": "km"},
        "focal_length_model": {"focal_length": camera.focal_length_mm},
        "focal2pixel_samples": [0.0, *camera.pixel_per_mm[0].tolist()],
        "focal2pixel_lines": [0.0, *camera.pixel_per_mm[1].tolist()],
        "detector_center": {"sample": camera.principal_point_px[0] + 0.5, "line": 0.0},
        "optical_distortion": {"radial": {"coefficients": [0.0, 0.0, 0.0]}},
        "body_rotation": {
            "ephemeris_times": [EPOCH_TDB_S],
            "quaternions": [[1.0, 0.0, 0.0, 0.0]],
            "time_dependent_frames": [31001, 1],
        },
        "instrument_pointing": {
            "ephemeris_times": (EPOCH_TDB_S + table.rotation_times_s).tolist(),
            "quaternions": (table.quaternions * [1.0, -1.0, -1.0, -1.0]).tolist(),
            "time_dependent_frames": [-1, 1],
        },
        "instrument_position": {
            "ephemeris_times": (EPOCH_TDB_S + table.position_times_s).tolist(),
            "positions": (table.positions_m / 1e3).tolist(),
            "unit": "km",
        },
        "line_scan_rate": (model.line_times + np.array([1.0, 0.0, 0.0])).tolist(),
        "starting_ephemeris_time": EPOCH_TDB_S,
    }
