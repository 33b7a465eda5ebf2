"""Lunar gravity by spherical harmonics: potential, acceleration and its gradient in principal axes.

The derivative of a series of solid harmonics along x, y or z is a series of the next degree (Cunningham 1970,
Celestial Mechanics 2, 207). The coefficients of acceleration and gradient are therefore computed once, and evaluated by
sums.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radioloc.constants import ARCSEC_RAD
from radioloc.dynamics.gravity_files import TIDE_SYSTEMS, read_gravity_file
from radioloc.errors import FileFormatError, InputError, error_context
from radioloc.lunar import rot_between
from radioloc.units import as_float_array
from radioloc.vectors import Floats

Complex = NDArray[np.complex128]

PACKAGED = {"GRGM660PRIM": Path(__file__).parent / "data" / "grgm660prim_150.npz"}
"""Fields of the package by name; GRGM660PRIM to degree 150."""

_DEFAULT_AXES = "PA_DE421"
_LUNAR_FIGURE = {(2, 0): -9.088e-5, (2, 2): 3.467e-5}  # GRGM660PRIM; lunar fields agree to 1e-5 of these
_FIGURE_TOLERANCE = 0.01
_MAX_AXES_OFFSET_RAD = 20.0 * ARCSEC_RAD
"""Largest angle between the axes of the figure and principal axes: 2 arcsec in GRGM660PRIM, 68 and 79 arcsec for
coefficients in mean-Earth axes."""


@dataclass(frozen=True, slots=True, eq=False)
class GravityField:
    """Gravity of the Moon; open one with :meth:`GravityField.open`.

    Potential GM/r sum over degree n and order m of (R/r)^n P_nm(sin latitude) (C_nm cos m lambda + S_nm sin m lambda),
    with fully normalized P_nm and C_nm, S_nm, positive, in the axes `frame`.
    """

    name: str
    gm_m3_s2: float
    radius_m: float  #: R
    frame: str  #: axes, such as PA_DE421
    tide_system: str  #: tide_free, zero_tide (C20 and C22 have the permanent tide) or unknown (as tide_free)
    c: Floats  #: shape (degree + 1, degree + 1), by degree and order
    s: Floats
    sigma_c: Floats  #: formal; zeros if the file lacks them
    sigma_s: Floats
    notes: tuple[str, ...] = ()  #: assumptions about properties that the file does not state

    @classmethod
    def open(
        cls,
        source: str | Path,
        degree: int | None = None,
        frame: str | None = None,
        tide_system: str | None = None,
    ) -> GravityField:
        """Open a field of the Moon.

        Parameters
        ----------
        source : str or path-like
            ``"GRGM660PRIM"`` of the package, or a file: ICGEM's ``.gfc`` or the PDS's SHADR ``.tab``.
        degree : int, optional
            Highest degree and order; all by default.
        frame : str, optional
            Axes of the coefficients, such as ``"PA_DE440"``; by default those of the header or label of the file, else
            ``"PA_DE421"``.
        tide_system : {"tide_free", "zero_tide"}, optional
            Whether C20 and C22 contain the permanent tide (zero_tide); by default as the file states.

        Raises
        ------
        FileFormatError
            The file is missing, damaged, not normalized, of another body, or in other axes than stated.
        InputError
            The degree is not an integer of 0 to the degree of the field; axes or tide system are unknown.

        Examples
        --------
        >>> from radioloc.dynamics import GravityField
        >>> GravityField.open("GRGM660PRIM", degree=50)
        <GravityField GRGM660PRIM to degree 50 in PA_DE421>
        """
        if str(source) in PACKAGED:
            with np.load(PACKAGED[str(source)], allow_pickle=False) as file:
                properties: dict[str, Any] = {
                    "name": str(source),
                    "frame": _DEFAULT_AXES,
                    "gm_m3_s2": float(file["gm_m3_s2"]),
                    "radius_m": float(file["radius_m"]),
                    "tide_system": str(file["tide_system"]),
                    **{key: _square(file[key]) for key in ("c", "s", "sigma_c", "sigma_s")},
                }
        else:
            properties = read_gravity_file(source)
        if tide_system is not None:
            if tide_system not in TIDE_SYSTEMS:
                raise InputError(
                    f"tide_system: expected one of {', '.join(TIDE_SYSTEMS)}, got {tide_system!r}"
                )
            properties["tide_system"] = tide_system
        axes = frame or properties["frame"]
        notes = tuple(_assumptions(properties, axes))
        field = cls(**properties | {"frame": axes or _DEFAULT_AXES, "notes": notes})
        _require_figure_axes(field, source)
        return field if degree is None else field.to_degree(degree)

    def __repr__(self) -> str:
        return f"<GravityField {self.name} to degree {self.degree} in {self.frame}>"

    @property
    def degree(self) -> int:
        """Highest degree and order."""
        return len(self.c) - 1

    def to_degree(self, degree: int) -> GravityField:
        """Return the field truncated at a degree.

        Raises
        ------
        InputError
            The degree is not an integer of 0 to the degree of the field.
        """
        if isinstance(degree, bool) or not isinstance(degree, int) or not 0 <= degree <= self.degree:
            raise InputError(
                f"degree: expected 0 to {self.degree}, the degree of {self.name}, got {degree!r}; reduce it or use "
                "another field"
            )
        part = slice(degree + 1)
        return replace(
            self,
            c=self.c[part, part],
            s=self.s[part, part],
            sigma_c=self.sigma_c[part, part],
            sigma_s=self.sigma_s[part, part],
        )

    def potential(self, position_pa_m: ArrayLike) -> Floats:
        """Return the potential, positive, m^2/s^2, () or (n,), at points in the field's axes, m, (3,) or (n, 3)."""
        return self._sums(position_pa_m, [self._coefficients()], 1)[..., 0]

    def acceleration(self, position_pa_m: ArrayLike) -> Floats:
        """Return the acceleration, m/s^2, at points in the field's axes, m; both of shape (3,) or (n, 3).

        Examples
        --------
        >>> from radioloc.dynamics import GravityField
        >>> field = GravityField.open("GRGM660PRIM", degree=2)
        >>> float(field.acceleration([1838.0e3, 0.0, 0.0])[0].round(6))
        -1.451943
        """
        return self._sums(position_pa_m, acceleration_series(self._coefficients()), 2)

    def gradient(self, position_pa_m: ArrayLike) -> Floats:
        """Return d(acceleration)/d(position), 1/s^2, (..., 3, 3), at points as in :meth:`acceleration`."""
        xx, xy, xz, yy, yz = np.moveaxis(
            self._sums(position_pa_m, gradient_series(self._coefficients()), 3), -1, 0
        )
        rows = [xx, xy, xz, xy, yy, yz, xz, yz, -xx - yy]
        return np.stack(rows, axis=-1).reshape((*xx.shape, 3, 3))

    def _coefficients(self) -> Complex:
        return self.c - 1j * self.s

    def _sums(self, position_pa_m: ArrayLike, series: list[Complex], power: int) -> Floats:
        points_m = as_float_array(position_pa_m, "m", "position_pa_m")
        if points_m.ndim == 0 or points_m.shape[-1] != 3:
            raise InputError(f"position_pa_m: expected the shape (3,) or (n, 3), got {points_m.shape}")
        if not (np.isfinite(points_m).all() and np.linalg.norm(points_m, axis=-1).all()):
            raise InputError(
                "position_pa_m: expected finite coordinates of points other than the Moon's centre"
            )
        # The compiler takes a third of a second to import.
        from radioloc.dynamics._harmonic_kernels import harmonic_sums_at

        table = stacked(series)
        sums = harmonic_sums_at(
            np.ascontiguousarray(points_m.reshape(-1, 3)), self.radius_m, table, recursion(len(table))
        )
        scale = self.gm_m3_s2 / self.radius_m**power
        return np.asarray(scale * sums.reshape((*points_m.shape[:-1], len(series))))


def _assumptions(properties: dict[str, Any], axes: str | None) -> Iterator[str]:
    """Yield notes on the values assumed for properties that neither the file nor the caller states."""
    if axes is None:
        yield (
            f"the gravity field {properties['name']} does not name its axes: {_DEFAULT_AXES} is assumed; state them by "
            "gravity_axes in [forces]"
        )
    if properties["tide_system"] == "unknown":
        yield (
            f"the tide system of the gravity field {properties['name']} is unknown: tide_free is assumed (tens of "
            "metres after a day if it is zero_tide); state it by gravity_tide_system in [forces]"
        )


def _require_figure_axes(field: GravityField, source: str | Path) -> None:
    """Raise an error if degree 2 of a lunar field belongs to other axes than those stated."""
    with error_context(f"{source}: gravity_axes:"):
        rotation = rot_between(field.frame, f"PA_{field.frame[3:]}")
    if field.degree < 2 or any(
        abs(field.c[place] / value - 1.0) > _FIGURE_TOLERANCE for place, value in _LUNAR_FIGURE.items()
    ):
        return
    c20, c21, c22 = np.sqrt([5.0, 5.0 / 3.0, 5.0 / 12.0]) * field.c[2, :3]
    _, s21, s22 = np.sqrt([5.0, 5.0 / 3.0, 5.0 / 12.0]) * field.s[2, :3]
    quadrupole = np.array(
        [
            [3.0 * c22 - 0.5 * c20, 3.0 * s22, 1.5 * c21],
            [3.0 * s22, -3.0 * c22 - 0.5 * c20, 1.5 * s21],
            [1.5 * c21, 1.5 * s21, c20],
        ]
    )
    in_principal_axes = rotation @ quadrupole @ rotation.T
    x, y, z = np.diag(in_principal_axes)
    offsets_rad = in_principal_axes[[1, 0, 0], [2, 2, 1]] / np.array([z - y, x - z, y - x])
    if (largest := np.abs(offsets_rad).max()) > _MAX_AXES_OFFSET_RAD:
        raise FileFormatError(
            source,
            f"expected coefficients in the axes {field.frame}, got degree 2 of a figure {largest / ARCSEC_RAD:.0f} "
            "arcsec off them; state the axes of the file, gravity_axes in [forces] (frame of GravityField.open), such "
            'as "ME_DE421"',
        )


def recursion(n_degrees: int) -> Floats:
    """Return factors of h_(n-1)m (diagonal: h_(n-1)(n-1)) and of h_(n-2)m in h_nm, (2, n_degrees, n_degrees)."""
    n, m = np.meshgrid(np.arange(float(n_degrees)), np.arange(float(n_degrees)), indexing="ij")
    tesseral = n > m
    first = np.where(tesseral, (2 * n - 1) * (2 * n + 1), 0.0) / np.where(tesseral, (n - m) * (n + m), 1.0)
    second = np.where(n > m + 1, (2 * n + 1) * (n + m - 1) * (n - m - 1), 0.0)
    second = second / np.where(n > m + 1, (n - m) * (n + m) * (2 * n - 3), 1.0)
    sectoral = (2 * n + 1) / np.maximum(2 * n, 1.0) * (1 + (n == 1))
    return np.sqrt(np.stack([np.where(n == m, sectoral, first), second]))


def stacked(series: list[Complex]) -> Floats:
    """Return series of coefficients C - i S in the layout of the compiled sums."""
    parts = [item.real for item in series] + [-item.imag for item in series]
    return np.ascontiguousarray(np.stack(parts, axis=1))


def acceleration_series(coefficients: Complex) -> list[Complex]:
    """Return series of the three components, without the factor GM/R^2, from that of the potential."""
    return [_derivative(coefficients, axis) for axis in "xyz"]


def gradient_series(coefficients: Complex) -> list[Complex]:
    """Return series of xx, xy, xz, yy and yz, without the factor GM/R^3; zz is -xx - yy."""
    by_x, by_y, _ = acceleration_series(coefficients)
    return [_derivative(by_x, axis) for axis in "xyz"] + [_derivative(by_y, axis) for axis in "yz"]


def _derivative(coefficients: Complex, axis: str) -> Complex:
    """Return coefficients C - i S of R times the derivative of a series along an axis."""
    # With Z_nm the harmonic without normalization (Cunningham's V + i W), dZ/dz = -(n-m+1) Z_(n+1)m / R and
    # (d/dx + i d/dy) Z = -Z_(n+1)(m+1) / R, (d/dx - i d/dy) Z = (n-m+2)(n-m+1) Z_(n+1)(m-1) / R; the square roots are
    # these with the ratio of normalizations.
    size = len(coefficients)
    n, m = np.meshgrid(np.arange(float(size)), np.arange(float(size)), indexing="ij")
    k = np.where(n >= m, coefficients, 0.0)
    of_degree = (2 * n + 1) / (2 * n + 3)
    out = np.zeros((size + 1, size + 1), dtype=np.complex128)
    if axis == "z":
        out[1:, :-1] = -k * np.sqrt(of_degree * np.abs((n + m + 1) * (n - m + 1)))
        return out
    up, down = (-0.5, 0.5) if axis == "x" else (0.5j, 0.5j)
    # The contribution of order -1 to order 0 is in order 1.
    up_factor = np.where(m == 0, np.sqrt(2.0), 1.0) * np.sqrt(of_degree * (n + m + 2) * (n + m + 1))
    down_factor = np.where(m == 1, np.sqrt(2.0), 1.0) * np.sqrt(of_degree * np.abs((n - m + 1) * (n - m + 2)))
    out[1:, 1:] += up * k * up_factor
    out[1:, :-2] += (down * k * down_factor)[:, 1:]
    out[:, 0] = out[:, 0].real
    return out


def _square(rows: NDArray[np.floating[Any]]) -> Floats:
    """Return rows of successive degrees as a square array by degree and order."""
    size = int((np.sqrt(8 * len(rows) + 1) - 1) / 2)
    out = np.zeros((size, size))
    out[np.tril_indices(size)] = rows
    return out
