"""Lens distortion: where a ray meets the focal plane, and where it would without distortion.

Each kind is one formula that goes one way, with its derivatives; the other way is Newton's method. Of several points
that a formula sends to the same place (a polynomial folds the plane far from the axis), the one that belongs to the
lens is that which Newton's method reaches from the undistorted place; others are not valid.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from radioloc.errors import InputError
from radioloc.vectors import Floats

Formula = Callable[[Floats, tuple[float, ...]], tuple[Floats, Floats]]

_ITERATIONS = 30
_CONVERGED = 1e-12
"""Step of Newton's method in units of the focal length or millimetres: 1e-10 of a pixel of 7 micrometres."""

_SAME_POINT = 1e-9  # the way there and back leaves less than this where it is the same point: 1e-7 of a pixel


@dataclass(frozen=True, slots=True)
class DistortionKind:
    """One kind of distortion."""

    name: str
    description: str
    formula: Formula  # of points, shape (n, 2), and coefficients: points and derivatives, shape (n, 2, 2)
    removes: bool  # the formula goes from the measured point to the ideal one
    in_millimetres: bool  # on the focal plane; otherwise in units of the focal length
    least: int  # coefficients
    most: int


@dataclass(frozen=True, slots=True)
class Distortion:
    """The distortion of one lens.

    Parameters
    ----------
    kind : str
        A name of :data:`KINDS`.
    coefficients : sequence of float
        In the order of the kind's description.

    Raises
    ------
    InputError
        The kind is not known; another number of coefficients, or one that is not finite.

    Examples
    --------
    >>> from radioloc.imaging import Distortion
    >>> import numpy as np
    >>> lens = Distortion("lrolrocnac", [1.81e-5])
    >>> lens.ideal(np.array([[0.0, 17.0]]))[0].round(4).tolist()
    [[0.0, 16.9115]]
    """

    kind: str
    coefficients: tuple[float, ...]

    def __init__(self, kind: str, coefficients: Sequence[float]) -> None:
        if kind not in KINDS:
            raise InputError(f"distortion {kind!r} is not known; use one of {', '.join(KINDS)}")
        try:
            values = tuple(float(one) for one in coefficients)
        except (TypeError, ValueError):
            values = (np.nan,)
        about = KINDS[kind]
        if not np.isfinite(values).all() or not about.least <= len(values) <= about.most:
            count = f"{about.least}" if about.least == about.most else f"{about.least} to {about.most}"
            raise InputError(
                f"distortion {kind!r} takes {count} finite numbers, {about.description}; not {coefficients!r:.60}"
            )
        object.__setattr__(self, "kind", kind)
        object.__setattr__(self, "coefficients", values + (0.0,) * (about.most - len(values)))

    @property
    def about(self) -> DistortionKind:
        """The kind's formula and units."""
        return KINDS[self.kind]

    def ideal(self, measured: Floats) -> tuple[Floats, Floats, NDArray[np.bool_]]:
        """Return points without distortion, (n, 2), in units by `about.in_millimetres`, derivatives, and validity."""
        return self._converted(measured, self.about.removes)

    def measured(self, ideal: Floats) -> tuple[Floats, Floats, NDArray[np.bool_]]:
        """Points where the lens has them, from points without distortion; shapes and units as :meth:`ideal`."""
        return self._converted(ideal, not self.about.removes)

    def _converted(self, points: Floats, by_formula: bool) -> tuple[Floats, Floats, NDArray[np.bool_]]:
        if not any(self.coefficients):
            identity = np.broadcast_to(np.eye(2), (len(points), 2, 2))
            return np.asarray(points, dtype=np.float64), identity, np.ones(len(points), dtype=bool)
        return self._formula(points) if by_formula else self._inverse(points)

    def _formula(self, points: Floats) -> tuple[Floats, Floats, NDArray[np.bool_]]:
        """By the formula; valid where the way back leads to the same point, or, from a pixel, begins to."""
        with np.errstate(over="ignore", invalid="ignore"):
            there, derivatives = self.about.formula(points, self.coefficients)
            if self.about.removes:
                return there, derivatives, _unfolded(derivatives)
            back, _, valid = self._inverse(there)
            near = _size(back - points) <= _SAME_POINT * (1.0 + _size(points))
        return there, derivatives, valid & near

    def _inverse(self, target: Floats) -> tuple[Floats, Floats, NDArray[np.bool_]]:
        """Points that the formula sends to the target, by Newton's method from the target itself."""
        points = np.array(target, dtype=np.float64)
        derivatives = np.broadcast_to(np.eye(2), (len(points), 2, 2)).copy()
        valid = np.zeros(len(points), dtype=bool)
        active = np.flatnonzero(np.isfinite(points).all(axis=-1))
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            for _ in range(_ITERATIONS):
                there, slope = self.about.formula(points[active], self.coefficients)
                inverse = inverse_2x2(slope)
                step = np.einsum("nij,nj->ni", inverse, target[active] - there)
                points[active] += step
                derivatives[active] = inverse
                done = _size(step) <= _CONVERGED * (1.0 + _size(points[active]))
                valid[active[done & _unfolded(slope)]] = True
                active = active[~done & np.isfinite(step).all(axis=-1)]
                if not len(active):
                    break
        points[~valid] = target[~valid]
        return points, derivatives, valid


def _size(points: Floats) -> Floats:
    """The larger of the components."""
    return np.maximum(np.abs(points[:, 0]), np.abs(points[:, 1]))


def _unfolded(derivatives: Floats) -> NDArray[np.bool_]:
    """Whether the plane is not turned over."""
    xx, xy, yx, yy = derivatives.reshape(-1, 4).T
    return np.asarray(xx * yy > xy * yx)


def inverse_2x2(matrices: Floats) -> Floats:
    """Inverses of matrices, shape (n, 2, 2); infinite where there is none."""
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


def _transverse(points: Floats, c: tuple[float, ...]) -> tuple[Floats, Floats]:
    x, y = points.T
    zero, one = np.zeros_like(x), np.ones_like(x)
    terms = np.stack([one, x, y, x * x, x * y, y * y, x**3, x * x * y, x * y * y, y**3])
    by_x = np.stack([zero, one, zero, 2 * x, y, zero, 3 * x * x, 2 * x * y, y * y, zero])
    by_y = np.stack([zero, zero, one, zero, x, 2 * y, zero, x * x, 2 * x * y, 3 * y * y])
    coefficients = np.array(c).reshape(2, 10)
    jacobian = np.stack([coefficients @ by_x, coefficients @ by_y], axis=-1)  # (2, n, 2)
    return (coefficients @ terms).T, np.swapaxes(jacobian, 0, 1)


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
        # At the axis the slope has no direction.
        outward = np.where(r[:, None] > 0.0, points / r[:, None], 0.0)
    jacobian = np.eye(2) + (coefficients @ slopes).T[:, :, None] * outward[:, None, :]
    return points + shift, jacobian


_RADIAL = "k0, k1, k2 of ideal = measured (1 - k0 - k1 r^2 - k2 r^4), mm"
_BROWN = "k1, k2, p1, p2, k3 as OpenCV orders them, in units of the focal length"
_TRANSVERSE = "ten coefficients of x, then ten of y, of 1 x y xx xy yy xxx xxy xyy yyy, mm"
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
        DistortionKind("transverse", _TRANSVERSE, _transverse, False, True, 20, 20),
        DistortionKind("lrolrocnac", _LROC_NAC, _lroc_nac, True, True, 1, 1),
        DistortionKind("kaguyalism", _KAGUYA, _kaguya, True, True, 10, 10),
    )
}
"""By name: those of image support data (Laura et al., ``usgscsm``; for Kaguya its SPICE instrument kernels,
SEL_TC_V01.TI), and Brown's (1971) as OpenCV has it."""
