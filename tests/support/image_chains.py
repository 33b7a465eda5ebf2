"""Homographies and random tie points of a descent, without images."""

from dataclasses import dataclass

import numpy as np

from radioloc.imaging.adjustment import TiePoints, adjust, approximate_places
from radioloc.imaging.homography import transformed
from radioloc.imaging.projections import Homographies

CENTRE = np.array([499.5, 499.5])
SIZE = 1000.0


@dataclass(frozen=True)
class Chain:
    """Images of 1000 x 1000 pixels of a plane, each a part as wide as the previous one."""

    images: int
    map_below: int  # number of images with features of the map
    tied: int = 40  # tie points of each image with the previous one
    on_map: int = 30  # features of the map per image
    part: float = 0.75
    drift_m: tuple[float, float] = (-80.0, 30.0)  # of an image's middle from one to the next

    def matrix(self, k):
        """Return the matrix from the plane, m, to pixels."""
        pixel_m, turn, tilt = 4.0 * self.part**k, 0.1 * k, 1e-4 * 0.7**k
        east_m, north_m = (k * drift for drift in self.drift_m)
        to_ground = np.array(
            [
                [pixel_m * np.cos(turn), pixel_m * np.sin(turn), 900.0 + east_m],
                [pixel_m * np.sin(turn), -pixel_m * np.cos(turn), -400.0 + north_m],
                [tilt, -tilt, 1.0],
            ]
        )
        to_middle = np.array([[1, 0, -CENTRE[0]], [0, 1, -CENTRE[1]], [0, 0, 1.0]])
        return np.linalg.inv(to_ground @ to_middle)

    def ground(self, k, pixel):
        return transformed(np.linalg.inv(self.matrix(k)), np.reshape(pixel, (-1, 2))).reshape(np.shape(pixel))

    @property
    def sizes(self):
        return np.full((self.images, 2), SIZE)

    def approximate(self):
        """Return homographies with errors of some pixels, as of products along the chain."""
        rng = np.random.default_rng(1)
        shift = [np.array([[1, 0, a], [0, 1, b], [0, 0, 1.0]]) for a, b in rng.normal(0, 5, (self.images, 2))]
        return np.array([s @ self.matrix(k) for k, s in enumerate(shift)])

    def adjusted(self, ties, start=None):
        matrices = self.approximate() if start is None else start
        return adjust(
            ties, Homographies.of_matrices(matrices, self.sizes), approximate_places(ties, matrices)
        )


def drawn_ties(chain, rng, *, sigma_px, map_sigma_m, stated=1.0, outliers=0.03):
    """Draw tie points of successive images, some of three, and of the map; a part of them is wrong."""
    image, place, map_place = [], [], []
    points = 0
    for k in range(chain.images):
        count = chain.tied if k else 0
        ground = chain.ground(k, rng.uniform(0.0, SIZE, (count + chain.on_map, 2)))
        for n, x in enumerate(ground):
            candidates = [i for i in range(max(0, k - 1 - n % 2), k) if n < count] + [k]
            visible = [
                i
                for i in candidates
                if (np.abs(transformed(chain.matrix(i), x[None]) - CENTRE) < SIZE / 2).all()
            ]
            if n >= count and k >= chain.map_below:
                continue
            if n >= count:
                map_place.append((points, x))
            elif len(visible) < 2:
                continue
            image += [(i, points) for i in visible]
            place += [transformed(chain.matrix(i), x[None])[0] for i in visible]
            points += 1
    image, pixels = np.array(image), np.array(place)
    pixels = pixels + rng.normal(0.0, sigma_px, pixels.shape)
    wrong = rng.random(len(pixels)) < outliers
    pixels[wrong] += rng.uniform(-200.0, 200.0, (wrong.sum(), 2)) * rng.choice([0.05, 1.0], (wrong.sum(), 1))
    map_m = np.array([x for _, x in map_place]) + rng.normal(0.0, map_sigma_m, (len(map_place), 2))
    return TiePoints(
        image=image[:, 0],
        point=image[:, 1],
        pixels=pixels,
        sigma_px=np.full(len(pixels), stated * sigma_px),
        map_point=np.array([j for j, _ in map_place]),
        map_m=map_m,
        map_sigma_m=np.full(len(map_m), stated * map_sigma_m),
    )
