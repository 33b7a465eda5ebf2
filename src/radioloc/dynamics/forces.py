"""Forces on a spacecraft about the Moon, and their parameters in a dynamic fit."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from radioloc.dynamics.gravity import GravityField
from radioloc.errors import InputError
from radioloc.quantities import EpochsLike, convert_fields
from radioloc.time import Epochs, to_scale
from radioloc.time.epochs import Tdb
from radioloc.units import set_fields

BODIES = ("earth", "sun", "venus", "jupiter", "saturn")
"""Point masses beside the Moon, in the order of the compiled code."""

Axes = Literal["RTN", "ICRF"]
Vector = tuple[float, float, float]

_ZERO = (0.0, 0.0, 0.0)
_AXIS_LETTERS = {"RTN": "rtn", "ICRF": "xyz"}


@dataclass(frozen=True, slots=True, eq=False)
class Acceleration:
    """Empirical acceleration, constant and once per revolution, or thrust of a finite manoeuvre.

    The acceleration is constant + cosine cos u + sine sin u; u is the angle along the orbit from the position at the
    epoch of the arc.

    Raises
    ------
    InputError
        Axes, components or epochs are invalid.
    """

    name: str
    axes: Axes = "RTN"  #: "RTN", "ICRF": radial, transverse and normal axes, or axes of the ICRF
    constant_m_s2: Vector = _ZERO  #: components along the axes, m/s^2
    cosine_m_s2: Vector = _ZERO  #: likewise
    sine_m_s2: Vector = _ZERO  #: likewise
    start: Tdb | None = None  #: single epochs, TDB; an open end by default
    stop: Tdb | None = None  #: likewise
    #: Normal of a fixed plane of radial, transverse and normal axes, ICRF axes. In a descent the orbital plane
    #: turns and degenerates.
    normal: Vector | None = None
    #: A-priori sigma of each component of the constant; by default it is not estimated.
    sigma_m_s2: float | None = None

    def __post_init__(self) -> None:
        convert_fields(self)
        _require_axes(self.name, self.axes)
        for key in ("constant_m_s2", "cosine_m_s2", "sine_m_s2"):
            _require_vector(self.name, key, getattr(self, key))
        if self.normal is not None:
            _require_vector(self.name, "normal", self.normal)
        for key in ("start", "stop"):
            epoch = getattr(self, key)
            if epoch is not None:
                set_fields(self, **{key: single_tdb_epoch(self.name, epoch)})
        if self.start is not None and self.stop is not None and self.stop.seconds_since(self.start)[0] <= 0.0:
            raise InputError(f"acceleration {self.name}: stop: expected an epoch after the start")

    def names(self) -> list[list[str]]:
        """Return names of components, of the constant such as ``NAME.r``, of cosine and sine such as ``NAME.cos_r``."""
        prefixes = ("", "cos_", "sin_")
        return [
            [f"{self.name}.{prefix}{letter}" for letter in _AXIS_LETTERS[self.axes]] for prefix in prefixes
        ]


@dataclass(frozen=True, slots=True, eq=False)
class Impulse:
    """Impulsive manoeuvre: a change of the velocity, m/s, at an epoch of TDB."""

    name: str
    epoch: Tdb
    delta_v_m_s: Vector = _ZERO
    axes: Axes = "RTN"  #: radial, transverse and normal of the state before, or ICRF

    def __post_init__(self) -> None:
        convert_fields(self)
        _require_axes(self.name, self.axes)
        _require_vector(self.name, "delta_v_m_s", self.delta_v_m_s)
        set_fields(self, epoch=single_tdb_epoch(self.name, self.epoch))

    def names(self) -> list[str]:
        """Return names of its components, such as ``NAME.r``."""
        return [f"{self.name}.{letter}" for letter in _AXIS_LETTERS[self.axes]]


@dataclass(frozen=True, slots=True, eq=False)
class Forces:
    """Forces on a spacecraft beside the central term of the Moon's gravity.

    Each can be omitted; docs/dynamics.md has their equations and sizes.

    Raises
    ------
    InputError
        A value is invalid, a body is unknown, or a name occurs twice.

    Examples
    --------
    >>> from radioloc.dynamics import Forces, GravityField
    >>> forces = Forces(GravityField.open("GRGM660PRIM", degree=100), radiation_m2_kg=0.014)
    >>> forces.parameters()
    {'k2': 0.02416, 'radiation': 0.014}
    >>> forces.with_parameters({"radiation": 0.012}).radiation_m2_kg
    0.012
    """

    gravity: GravityField  #: harmonics to the field's degree (:meth:`GravityField.open`)
    #: GM of the Moon; that of the ephemeris by default, which is TDB-compatible like the relativity of this
    #: class. Fields made without these terms, such as GRGM660PRIM, have a GM that is smaller by 5e-8.
    gm_m3_s2: float | None = None
    #: Point masses, of earth, sun, venus, jupiter, saturn; a body that the ephemeris lacks is an error.
    bodies: tuple[str, ...] = BODIES
    #: Love number of the Moon's tides by Earth and Sun. Only their variable part is added to a field whose tide
    #: system is ``zero_tide``, which contains the permanent part in C20 and C22.
    k2: float = 0.02416  #: Williams et al. (2014), J. Geophys. Res. Planets 119, 1546
    figures: bool = True  #: the Earth's J2, and the pull of the Earth at the Moon's figure
    relativity: bool = True  #: post-Newtonian terms of Moon, Earth and Sun in barycentric coordinates
    #: Radiation coefficient times area over mass, C_R A/m, of sunlight (with the shadows of the Moon and the
    #: Earth).
    radiation_m2_kg: float = 0.0
    #: Whether to add the pressure of light and heat from the Moon's ground, with the same coefficient.
    moonlight: bool = True
    accelerations: tuple[Acceleration, ...] = ()  #: empirical accelerations and finite manoeuvres
    impulses: tuple[Impulse, ...] = ()  #: impulsive manoeuvres
    gradient_degree: int = 40  #: highest degree of the harmonics in the partials

    def __post_init__(self) -> None:
        convert_fields(self)
        if not (isinstance(self.gradient_degree, int) and self.gradient_degree >= 0):
            raise InputError(
                f"gradient_degree: expected an integer of 0 or more, got {self.gradient_degree!r}"
            )
        for body in self.bodies:
            if body not in BODIES:
                raise InputError(f"bodies: expected {', '.join(BODIES)}, got {body!r}")
        for key in ("gm_m3_s2", "k2", "radiation_m2_kg"):
            value = getattr(self, key)
            if value is not None and not np.isfinite(value):
                raise InputError(f"{key}: expected a finite number, got {value}")
        names = [item.name for item in self.accelerations] + [item.name for item in self.impulses]
        if len(set(names)) < len(names):
            raise InputError(f"accelerations and impulses: expected unique names, got {', '.join(names)}")

    def parameters(self) -> dict[str, float]:
        """Return the values that can be estimated, by name, in SI units.

        ``gm`` (if it is given), ``k2``, ``radiation`` (C_R A/m), and of an acceleration or impulse its components:
        ``NAME.r``, ``NAME.t``, ``NAME.n`` or ``NAME.x``, ``NAME.y``, ``NAME.z``, of an acceleration also
        ``NAME.cos_r``, ``NAME.sin_r`` and so on.
        """
        values = {} if self.gm_m3_s2 is None else {"gm": self.gm_m3_s2}
        values |= {"k2": self.k2, "radiation": self.radiation_m2_kg}
        for item in self.accelerations:
            vectors = item.constant_m_s2, item.cosine_m_s2, item.sine_m_s2
            for names, vector in zip(item.names(), vectors, strict=True):
                values |= dict(zip(names, vector, strict=True))
        for impulse in self.impulses:
            values |= dict(zip(impulse.names(), impulse.delta_v_m_s, strict=True))
        return values

    def with_parameters(self, values: Mapping[str, float]) -> Forces:
        """Return forces with other values of parameters, by the names of :meth:`parameters`, and ``gm``.

        Raises
        ------
        InputError
            A name is unknown.
        """
        all_values = {"gm": 0.0} | self.parameters()
        for name in values:
            if name not in all_values:
                raise InputError(
                    f"parameters of forces: expected {', '.join(sorted(all_values))}, got {name!r}"
                )
        all_values |= values

        def vector(names: list[str]) -> Vector:
            x, y, z = (float(all_values[name]) for name in names)
            return x, y, z

        accelerations = []
        for item in self.accelerations:
            constant, cosine, sine = map(vector, item.names())
            accelerations.append(replace(item, constant_m_s2=constant, cosine_m_s2=cosine, sine_m_s2=sine))
        return replace(
            self,
            gm_m3_s2=values.get("gm", self.gm_m3_s2),
            k2=values.get("k2", self.k2),
            radiation_m2_kg=values.get("radiation", self.radiation_m2_kg),
            accelerations=tuple(accelerations),
            impulses=tuple(replace(item, delta_v_m_s=vector(item.names())) for item in self.impulses),
        )


def _require_axes(name: str, axes: str) -> None:
    if axes not in _AXIS_LETTERS:
        raise InputError(f"{name}: axes: expected RTN or ICRF, got {axes!r}")


def _require_vector(name: str, key: str, value: Vector) -> None:
    if np.shape(value) != (3,) or not np.isfinite(value).all():
        raise InputError(f"{name}: {key}: expected three finite numbers, got {value}")


def single_tdb_epoch(name: str, epoch: EpochsLike) -> Epochs:
    """Return a single epoch of any scale in TDB; several are an InputError."""
    tdb = to_scale(epoch, "TDB")
    if len(tdb) != 1:
        raise InputError(f"{name}: expected a single epoch, got {len(tdb)}")
    return tdb
