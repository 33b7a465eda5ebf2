"""Forces on a spacecraft about the Moon, and their parameters in a dynamic fit."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from radioloc.dynamics.gravity import GravityField
from radioloc.errors import InputError
from radioloc.quantities import convert_fields
from radioloc.time import Epochs
from radioloc.time.epochs import Tdb

BODIES = ("earth", "sun", "venus", "jupiter", "saturn")
"""Point masses beside the Moon, in the order in which compiled code has them."""

Axes = Literal["RTN", "ICRF"]
Vector = tuple[float, float, float]

_ZERO = (0.0, 0.0, 0.0)
_LETTERS = {"RTN": "rtn", "ICRF": "xyz"}


@dataclass(frozen=True, slots=True, eq=False)
class Acceleration:
    """A given acceleration: empirical, constant and once per revolution, or the thrust of a finite manoeuvre.

    Constant + cosine cos u + sine sin u; u is the angle along the orbit from the position at the arc's epoch.

    Parameters
    ----------
    name : str
    axes : {"RTN", "ICRF"}
        Radial, transverse and normal, or those of the ICRF.
    constant_m_s2, cosine_m_s2, sine_m_s2 : tuple of float
        Components along the axes.
    start, stop : Epochs, optional
        TDB, one each; without one it acts always before or after.
    normal : tuple of float, optional
        Of a plane that radial, transverse and normal axes keep to, ICRF axes: on a descent that of the orbit turns and
        vanishes.
    sigma_m_s2 : float, optional
        A priori, of each component of the constant; without one it is not estimated.
    """

    name: str
    axes: Axes = "RTN"
    constant_m_s2: Vector = _ZERO
    cosine_m_s2: Vector = _ZERO
    sine_m_s2: Vector = _ZERO
    start: Tdb | None = None
    stop: Tdb | None = None
    normal: Vector | None = None
    sigma_m_s2: float | None = None

    def __post_init__(self) -> None:
        convert_fields(self)
        _require_axes(self.name, self.axes)
        for key in ("constant_m_s2", "cosine_m_s2", "sine_m_s2"):
            _require_vector(self.name, key, getattr(self, key))
        if self.normal is not None:
            _require_vector(self.name, "normal", self.normal)
        for moment in (self.start, self.stop):
            if moment is not None:
                require_one_epoch(self.name, moment)
        if self.start is not None and self.stop is not None and self.stop.seconds_since(self.start)[0] <= 0.0:
            raise InputError(f"acceleration {self.name}: stop is not after start; exchange or correct them")

    def names(self) -> list[list[str]]:
        """Names of its components: of the constant such as ``NAME.r``, of cosine and sine such as ``NAME.cos_r``."""
        return [
            [f"{self.name}.{of}{letter}" for letter in _LETTERS[self.axes]] for of in ("", "cos_", "sin_")
        ]


@dataclass(frozen=True, slots=True, eq=False)
class Impulse:
    """A manoeuvre that changes the velocity at once."""

    name: str
    epoch: Tdb
    delta_v_m_s: Vector = _ZERO
    axes: Axes = "RTN"  # of the state before, or those of the ICRF

    def __post_init__(self) -> None:
        convert_fields(self)
        _require_axes(self.name, self.axes)
        _require_vector(self.name, "delta_v_m_s", self.delta_v_m_s)
        require_one_epoch(self.name, self.epoch)

    def names(self) -> list[str]:
        """Names of its components, such as ``NAME.r``."""
        return [f"{self.name}.{letter}" for letter in _LETTERS[self.axes]]


@dataclass(frozen=True, slots=True, eq=False)
class Forces:
    """Forces on a spacecraft beside the central term of the Moon's gravity.

    Each can be left out; docs/dynamics.md has their equations and sizes.

    Parameters
    ----------
    gravity : GravityField
        Harmonics to the field's degree (:meth:`GravityField.open`).
    gm_m3_s2 : float, optional
        GM of the Moon; that of the ephemeris by default, which is TDB-compatible as the relativity here. Fields made
        without these terms, as GRGM660PRIM, have one that is smaller by 5e-8.
    bodies : tuple of str
        Point masses, of earth, sun, venus, jupiter, saturn; those that the ephemeris does not hold are an error.
    k2 : float
        Love number of the Moon's tides by Earth and Sun. Only their variable part is added to a field whose tide system
        is ``zero_tide``, which contains the permanent part in C20 and C22.
    figures : bool
        The Earth's J2, and the pull of the Earth at the Moon's figure.
    relativity : bool
        Post-Newtonian terms of Moon, Earth and Sun in barycentric coordinates.
    radiation_m2_kg : float
        Radiation coefficient times area over mass, C_R A/m, of sunlight (with the shadows of the Moon and the Earth).
    moonlight : bool
        Whether light and heat from the Moon's ground press too, by the same coefficient.
    accelerations, impulses : tuple
        Empirical accelerations and manoeuvres.
    gradient_degree : int
        Highest degree of the harmonics in the partials.

    Examples
    --------
    >>> from radioloc.dynamics import Forces, GravityField
    >>> forces = Forces(GravityField.open("GRGM660PRIM", degree=100), radiation_m2_kg=0.014)
    >>> forces.parameters()
    {'k2': 0.02416, 'radiation': 0.014}
    >>> forces.with_parameters({"radiation": 0.012}).radiation_m2_kg
    0.012
    """

    gravity: GravityField
    gm_m3_s2: float | None = None
    bodies: tuple[str, ...] = BODIES
    k2: float = 0.02416  # Williams et al. (2014), J. Geophys. Res. Planets 119, 1546
    figures: bool = True
    relativity: bool = True
    radiation_m2_kg: float = 0.0
    moonlight: bool = True
    accelerations: tuple[Acceleration, ...] = ()
    impulses: tuple[Impulse, ...] = ()
    gradient_degree: int = 40

    def __post_init__(self) -> None:
        convert_fields(self)
        if not (isinstance(self.gradient_degree, int) and self.gradient_degree >= 0):
            raise InputError(f"gradient_degree {self.gradient_degree!r} is not 0 or a higher integer")
        for body in self.bodies:
            if body not in BODIES:
                raise InputError(f"body {body!r} is not known as a force; use some of {', '.join(BODIES)}")
        for key in ("gm_m3_s2", "k2", "radiation_m2_kg"):
            value = getattr(self, key)
            if value is not None and not np.isfinite(value):
                raise InputError(f"{key} of the forces is {value}; give a finite number")
        names = [one.name for one in self.accelerations] + [one.name for one in self.impulses]
        if len(set(names)) < len(names):
            raise InputError(
                f"accelerations and impulses have the names {', '.join(names)}; give each its own"
            )

    def parameters(self) -> dict[str, float]:
        """Numbers that can be estimated, by name, in SI units.

        ``gm`` (if it is given), ``k2``, ``radiation`` (C_R A/m), and of an acceleration or impulse its components:
        ``NAME.r``, ``NAME.t``, ``NAME.n`` or ``NAME.x``, ``NAME.y``, ``NAME.z``, of an acceleration also
        ``NAME.cos_r``, ``NAME.sin_r`` and so on.
        """
        own = {"gm": self.gm_m3_s2, "k2": self.k2, "radiation": self.radiation_m2_kg}
        found = {name: value for name, value in own.items() if value is not None}
        for one in self.accelerations:
            for names, of in zip(
                one.names(), (one.constant_m_s2, one.cosine_m_s2, one.sine_m_s2), strict=True
            ):
                found |= dict(zip(names, of, strict=True))
        for impulse in self.impulses:
            found |= dict(zip(impulse.names(), impulse.delta_v_m_s, strict=True))
        return found

    def with_parameters(self, values: Mapping[str, float]) -> Forces:
        """Return forces with other values of parameters, by the names of :meth:`parameters`, and ``gm``.

        Raises
        ------
        InputError
            There is no parameter of that name.
        """
        known = {"gm": 0.0} | self.parameters()
        for name in values:
            if name not in known:
                raise InputError(f"no force has the parameter {name!r}; there are {', '.join(sorted(known))}")
        known |= values

        def now(names: list[str]) -> Vector:
            x, y, z = (float(known[name]) for name in names)
            return x, y, z

        accelerations = []
        for one in self.accelerations:
            constant, cosine, sine = (now(names) for names in one.names())
            accelerations.append(replace(one, constant_m_s2=constant, cosine_m_s2=cosine, sine_m_s2=sine))
        return replace(
            self,
            gm_m3_s2=values.get("gm", self.gm_m3_s2),
            k2=values.get("k2", self.k2),
            radiation_m2_kg=values.get("radiation", self.radiation_m2_kg),
            accelerations=tuple(accelerations),
            impulses=tuple(replace(one, delta_v_m_s=now(one.names())) for one in self.impulses),
        )


def _require_axes(name: str, axes: str) -> None:
    if axes not in _LETTERS:
        raise InputError(f"{name}: axes {axes!r} are not known; use RTN or ICRF")


def _require_vector(name: str, key: str, value: Vector) -> None:
    if np.shape(value) != (3,) or not np.isfinite(value).all():
        raise InputError(f"{name}: {key} is {value}; give three finite numbers")


def require_one_epoch(name: str, moment: Epochs) -> None:
    """Raise :class:`InputError` unless it is one epoch of TDB."""
    moment.require("TDB")
    if len(moment) != 1:
        raise InputError(f"{name}: one epoch is needed, but {len(moment)} are given")
