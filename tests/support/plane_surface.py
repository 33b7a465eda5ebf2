"""Plane as a surface for geometry by hand."""

from dataclasses import dataclass

import numpy as np


@dataclass
class Plane:
    point_m: np.ndarray
    normal: np.ndarray  # of any length; it shows up
    mean_earth = False

    def __post_init__(self):
        self.normal = np.array(self.normal) / np.linalg.norm(self.normal)

    def intersect(self, origins_m, directions):
        distance_m = ((self.point_m - origins_m) @ self.normal) / (directions @ self.normal)
        return origins_m + distance_m[:, None] * directions, distance_m >= 0.0

    def gradient(self, points_m):
        return np.broadcast_to(self.normal, points_m.shape)
