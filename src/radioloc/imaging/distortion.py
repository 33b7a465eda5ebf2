"""Lens distortion: measured points on the focal plane to ideal ones, without distortion, and back.

Each kind has one formula in one direction, with its derivatives; the inverse is found by Newton's method. A polynomial
folds the plane far from the axis. Only the point that Newton's method reaches from the ideal place is valid.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from radioloc.errors import InputError
from radioloc.units import set_fields
from radioloc.vectors import Floats

Formula = Callable[[Floats, tuple[float, ...]], tuple[Floats, Floats]]

_MAX_ITERATIONS = 30
# Step of Newton's method in units of the focal length or millimetres: 1e-10 of a pixel of 7 micrometres.
_STEP_TOLERANCE = 1e-12
_MAX_SAFE_SLOPE = 0.5  # of the displacement by distortion, for which the formula cannot fold the plane
_ROUND_TRIP_TOLERANCE = 1e-9  # of measured points that the lens can produce: 1e-7 of a pixel


@dataclass(frozen=True, slots=True)
class DistortionKind:
    """Formula of a distortion with its units and number of coefficients."""

    name: str
    description: str
    formula: Formula  # of points, shape (n, 2), and coefficients: points and derivatives, shape (n, 2, 2)
    removes: bool  # whether the formula leads from the measured point to the ideal one
    in_millimetres: bool  # on the focal plane; otherwise in units of the focal length
    min_count: int  # of coefficients
    max_count: int


@dataclass(frozen=True, slots=True)
class Distortion:
    """Distortion of a lens.

    Raises
    ------
    InputError
        Unknown kind; wrong number of coefficients, or one that is not finite.

    Examples
    --------
    >>> from radioloc.imaging import Distortion
    >>> import numpy as np
    >>> lens = Distortion("lrolrocnac", [1.81e-5])
    >>> lens.ideal(np.array([[0.0, 17.0]]))[0].round(4).tolist()
    [[0.0, 16.9115]]
    """

    kind: str  #: a name of :data:`KINDS`
    coefficients: tuple[float, ...]  #: in the order of the kind's description

    def __init__(self, kind: str, coefficients: Sequence[float]) -> None:
        if kind not in KINDS:
            raise InputError(f"distortion: expected one of {', '.join(KINDS)}, got {kind!r}")
        try:
            values = tuple(float(value) for value in coefficients)
        except (TypeError, ValueError):
            values = (np.nan,)
        low, high = KINDS[kind].min_count, KINDS[kind].max_count
        if not np.isfinite(values).all() or not low <= len(values) <= high:
            count = f"{low}" if low == high else f"{low} to {high}"
            raise InputError(
                f"distortion {kind!r}: expected {count} finite numbers, {KINDS[kind].description}; got "
                f"{coefficients!r:.60}"
            )
        set_fields(self, kind=kind, coefficients=values + (0.0,) * (high - len(values)))

    @property
    def definition(self) -> DistortionKind:
        """Formula and units of the kind."""
        return KINDS[self.kind]

    def ideal(self, measured: Floats) -> tuple[Floats, Floats, NDArray[np.bool_]]:
        """Return points without distortion, (n, 2), their derivatives, (n, 2, 2), and validity; units by the kind."""
        return self._converted(measured, self.definition.removes)

    def measured(self, ideal: Floats) -> tuple[Floats, Floats, NDArray[np.bool_]]:
        """Return distorted points from points without distortion; shapes and units as :meth:`ideal`."""
        return self._converted(ideal, not self.definition.removes)

    def _converted(self, points: Floats, by_formula: bool) -> tuple[Floats, Floats, NDArray[np.bool_]]:
        if not any(self.coefficients):
            identity = np.broadcast_to(np.eye(2), (len(points), 2, 2))
            return np.asarray(points, dtype=np.float64), identity, np.ones(len(points), dtype=bool)
        return self._formula(points) if by_formula else self._inverse(points)

    def _formula(self, points: Floats) -> tuple[Floats, Floats, NDArray[np.bool_]]:
        """Apply the formula; valid where it does not fold the plane."""
        with np.errstate(over="ignore", invalid="ignore"):
            images, derivatives = self.definition.formula(points, self.coefficients)
            if self.definition.removes:
                return images, derivatives, _has_positive_determinant(derivatives)
            # Coefficients of one sign bound the derivatives as far as the farthest point.
            farthest = np.full((1, 2), np.abs(points).max(initial=0.0))
            [bound] = self.definition.formula(farthest, tuple(map(abs, self.coefficients)))[1] - np.eye(2)
            if bound.sum(axis=1).max() < _MAX_SAFE_SLOPE:
                return images, derivatives, np.ones(len(points), bool)
            origins, _, valid = self._inverse(images)
            consistent = _size(origins - points) <= _ROUND_TRIP_TOLERANCE * (1.0 + _size(points))
        return images, derivatives, valid & consistent

    def _inverse(self, target: Floats) -> tuple[Floats, Floats, NDArray[np.bool_]]:
        """Invert the formula by Newton's method from the target itself."""
        points = np.array(target, dtype=np.float64)
        derivatives = np.broadcast_to(np.eye(2), (len(points), 2, 2)).copy()
        valid = np.zeros(len(points), dtype=bool)
        active = np.flatnonzero(np.isfinite(points).all(axis=-1))
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            for _ in range(_MAX_ITERATIONS):
                images, slope = self.definition.formula(points[active], self.coefficients)
                inverse = _inverse_2x2(slope)
                step = np.einsum("nij,nj->ni", inverse, target[active] - images)
                points[active] += step
                derivatives[active] = inverse
                done = _size(step) <= _STEP_TOLERANCE * (1.0 + _size(points[active]))
                valid[active[done & _has_positive_determinant(slope)]] = True
                active = active[~done & np.isfinite(step).all(axis=-1)]
                if not len(active):
                    break
        points[~valid] = target[~valid]
        return points, derivatives, valid


def _size(points: Floats) -> Floats:
    """Return the larger of the absolute components."""
    return np.maximum(np.abs(points[:, 0]), np.abs(points[:, 1]))


def _has_positive_determinant(derivatives: Floats) -> NDArray[np.bool_]:
    xx, xy, yx, yy = derivatives.reshape(-1, 4).T
    return np.asarray(xx * yy > xy * yx)


def _inverse_2x2(matrices: Floats) -> Floats:
    """Return inverses of matrices, shape (n, 2, 2); infinite for singular ones."""
    a, b, c, d = matrices[:, 0, 0], matrices[:, 0, 1], matrices[:, 1, 0], matrices[:, 1, 1]
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.stack([d, -b, -c, a], axis=-1).reshape(-1, 2, 2) / (a * d - b * c)[:, None, None]


def _matrices(xx: Floats, xy: Floats, yx: Floats, yy: Floats) -> Floats:
    return np.stack([xx, xy, yx, yy], axis=-1).reshape(-1, 2, 2)


def _radial(points: Floats, c: tuple[float, ...]) -> tuple[Floats, Floats]:
    x, y = points.T
    r2 = x * x + y * y
    factor = 1.0 - (c[0] + r2 * (c[1] + r2 * c[2]))
    slope = -2.0 * (c[1] + 2.0 * c[2] * r2)  # of the factor, by r2, times two
    jacobian = _matrices(factor + slope * x * x, slope * x * y, slope * x * y, factor + slope * y * y)
    return points * factor[:, None], jacobian


def _brown(points: Floats, c: tuple[float, ...]) -> tuple[Floats, Floats]:
    k1, k2, p1, p2, k3 = c
    x, y = points.T
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = 2.0 * (k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3))
    u = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)
    v = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y
    mixed = slope * x * y + 2.0 * (p1 * x + p2 * y)
    jacobian = _matrices(
        radial + slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x,
        mixed,
        mixed,
        radial + slope * y * y + 6.0 * p1 * y + 2.0 * p2 * x,
    )
    return np.stack([u, v], axis=-1), jacobian


def _lroc_nac(points: Floats, c: tuple[float, ...]) -> tuple[Floats, Floats]:
    x, y = points.T
    factor = 1.0 + c[0] * y * y
    zero = np.zeros_like(x)
    jacobian = _matrices(np.ones_like(x), zero, zero, (1.0 - c[0] * y * y) / factor**2)
    return np.stack([x, y / factor], axis=-1), jacobian


def _kaguya(points: Floats, c: tuple[float, ...]) -> tuple[Floats, Floats]:
    x, y = points.T
    r = np.hypot(x, y)
    powers = np.stack([np.ones_like(r), r, r * r, r**3])
    slopes = np.stack([np.zeros_like(r), np.ones_like(r), 2.0 * r, 3.0 * r * r])
    coefficients = np.array([c[1:5], c[6:10]])
    shift = (coefficients @ powers).T + np.array([c[0], c[5]])
    with np.errstate(invalid="ignore", divide="ignore"):
        # The direction of the slope is undefined at the axis.
        outward = np.where(r[:, None] > 0.0, points / r[:, None], 0.0)
    jacobian = np.eye(2) + (coefficients @ slopes).T[:, :, None] * outward[:, None, :]
    return points + shift, jacobian


_RADIAL = "k0, k1, k2 of ideal = measured (1 - k0 - k1 r^2 - k2 r^4), mm"
_BROWN = "k1, k2, p1, p2, k3 as OpenCV orders them, in units of the focal length"
_LROC_NAC = "k of ideal y = measured y / (1 + k y^2), mm"
_KAGUYA = (
    "boresight x, a0 to a3, boresight y, b0 to b3 of ideal x = measured x + boresight "
    "x + a0 + a1 r + a2 r^2 + a3 r^3, and y with b, mm"
)
KINDS = {
    kind.name: kind
    for kind in (
        DistortionKind("none", "no coefficients", _radial, True, False, 0, 0),
        DistortionKind("radial", _RADIAL, _radial, True, True, 3, 3),
        DistortionKind("brown", _BROWN, _brown, False, False, 1, 5),
        DistortionKind("lrolrocnac", _LROC_NAC, _lroc_nac, True, True, 1, 1),
        DistortionKind("kaguyalism", _KAGUYA, _kaguya, True, True, 10, 10),
    )
}
"""Kinds by name: those of image support data of lunar cameras (Laura et al., ``usgscsm``; for Kaguya its SPICE
instrument kernels, SEL_TC_V01.TI), and Brown's (1971) as in OpenCV."""
