"""Position of a point fixed to the Moon, with its frame."""

from __future__ import annotations

from dataclasses import dataclass
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from radioloc.constants import C_M_S
from radioloc.ephemeris import CONSTANTS, Ephemeris, EphemerisConstants, LunarOrientation
from radioloc.errors import InputError, require_type
from radioloc.lunar.frames import rot_icrf_to_pa, rot_pa_to_me
from radioloc.lunar.selenographic import (
    cartesian_to_selenographic,
    require_lunar_height,
    selenographic_to_cartesian,
)
from radioloc.quantities import EpochsLike, FloatLike, accepts_quantities
from radioloc.units import as_metres, set_fields
from radioloc.vectors import Floats


@dataclass(frozen=True, slots=True, eq=False)
class LunarPosition:
    """A point fixed to the Moon.

    Raises
    ------
    InputError
        The frame has another name, or the point is not three finite numbers near the lunar surface.
    """

    #: ``"PA_DE421"`` (principal axes) or ``"ME_DE421"`` (mean Earth/mean rotation), or those of another
    #: ephemeris.
    frame: str
    #: (3,), Cartesian coordinates in that frame, m where they have no unit; kept as a read-only array.
    xyz_m: Floats

    def __post_init__(self) -> None:
        axes, _, ephemeris = self.frame.partition("_") if isinstance(self.frame, str) else ("", "", "")
        if axes not in ("PA", "ME") or not ephemeris:
            raise InputError(
                f"frame {self.frame!r} is not known; use PA_DE421 (principal axes) or ME_DE421 (mean Earth)"
            )
        try:
            xyz = np.array(as_metres(self.xyz_m, "xyz_m"), dtype=np.float64)
        except (TypeError, ValueError):
            xyz = np.empty(0)
        if xyz.shape != (3,) or not np.isfinite(xyz).all():
            raise InputError(f"a position needs three finite numbers in metres, not {self.xyz_m!r}")
        radius_m = float(np.linalg.norm(xyz))
        if not 1.6e6 < radius_m < 1.9e6:
            raise InputError(
                f"a position {radius_m / 1e3:.3f} km from the Moon's centre is not on its surface "
                "(1737.4 km, give or take 11 km); are the coordinates in metres?"
            )
        xyz.flags.writeable = False
        set_fields(self, xyz_m=xyz)

    @classmethod
    def from_cartesian(cls, xyz_m: ArrayLike, frame: str) -> LunarPosition:
        """Build from x, y, z: metres, or a Quantity of length."""
        return cls(frame, as_metres(xyz_m, "xyz_m"))

    @classmethod
    @accepts_quantities
    def from_selenographic(
        cls, longitude_deg: FloatLike, latitude_deg: FloatLike, height_m: FloatLike, frame: str = "ME_DE421"
    ) -> LunarPosition:
        """Build from east longitude and latitude in degrees and height above the 1737.4 km sphere in metres.

        Quantities of astropy may be in any unit of angle and length.

        Raises
        ------
        InputError
            A number is not finite, a latitude beyond 90 degrees, a longitude beyond 360, a height no terrain has.

        Examples
        --------
        >>> from radioloc.lunar import LunarPosition
        >>> LunarPosition.from_selenographic(0.0, 90.0, 600.0).xyz_m.round(3).tolist()
        [0.0, 0.0, 1738000.0]
        """
        coordinates = {"longitude_deg": longitude_deg, "latitude_deg": latitude_deg, "height_m": height_m}
        for name, value in coordinates.items():
            require_type(name, value, Real)
        if not -360.0 <= longitude_deg <= 360.0:
            raise InputError(f"longitude_deg = {longitude_deg!r} is not between -360 and 360")
        if not -90.0 <= latitude_deg <= 90.0:
            raise InputError(f"latitude_deg = {latitude_deg!r} is not between -90 and 90")
        require_lunar_height(height_m)
        xyz_m = selenographic_to_cartesian(np.radians(longitude_deg), np.radians(latitude_deg), height_m)
        return cls.from_cartesian(xyz_m, frame)

    def __repr__(self) -> str:
        longitude_deg, latitude_deg, height_m = self.selenographic
        place = f"{longitude_deg:.6f} deg E, {latitude_deg:.6f} deg N, {height_m:.1f} m"
        return f"<LunarPosition {place} ({self.frame})>"

    @property
    def selenographic(self) -> tuple[float, float, float]:
        """East longitude and latitude in degrees, height above the 1737.4 km sphere in metres."""
        longitude_rad, latitude_rad, height_m = cartesian_to_selenographic(self.xyz_m)
        return float(np.degrees(longitude_rad)), float(np.degrees(latitude_rad)), float(height_m)

    @accepts_quantities
    def to_gcrs(self, tdb: EpochsLike) -> Any:
        """Return the direction of the point from the geocentre as an astropy ``SkyCoord`` in GCRS, shape (n,).

        It includes the light time; astropy converts it to a station's azimuth and elevation. Its error of up to 0.1
        arcseconds suffices for pointing, not for measurements.

        Parameters
        ----------
        tdb : Epochs or Time
            Epochs of reception; a Time in any scale.

        Examples
        --------
        >>> from astropy.time import Time
        >>> from radioloc.lunar import LunarPosition
        >>> lander = LunarPosition.from_selenographic(-51.9162, 43.0584, -2550.4)
        >>> lander.to_gcrs(Time("2020-12-01T15:11:00")).ra.deg.round(2).tolist()
        [82.92]
        """
        from astropy.coordinates import GCRS, CartesianRepresentation, SkyCoord

        name = self.frame.partition("_")[2]
        pa_m = self.to_frame(f"PA_{name}").xyz_m
        ephemeris, libration = Ephemeris.open(name), LunarOrientation.open(name)
        light_s, xyz_m = 0.0, np.zeros((len(tdb), 3))
        for _ in range(2):
            emission = tdb.shifted(-light_s)
            from_centre_m = pa_m @ rot_icrf_to_pa(libration.angles(emission)[0])
            xyz_m = ephemeris.geocentric("moon", emission)[0] + from_centre_m
            light_s = np.linalg.norm(xyz_m, axis=-1) / C_M_S
        return SkyCoord(GCRS(CartesianRepresentation(xyz_m, unit="m", xyz_axis=-1), obstime=tdb.to_time()))

    def to_frame(self, frame: str) -> LunarPosition:
        """Return the point in the axes of another ephemeris.

        Parameters
        ----------
        frame : str
            ``"PA_DE421"``, ``"ME_DE421"``, ``"PA_DE440"``, ...

        Raises
        ------
        InputError
            The constants of an ephemeris are not known, or the mean-Earth axes of the two ephemerides differ.

        Notes
        -----
        Two ephemerides are connected by their shared mean-Earth axes, at constant angles fitted over decades. Principal
        axes of DE421 and DE440 differ by 1.3 to 1.8 m on the surface in 1990 to 2050; after the rotation 0.06 to
        0.53 m remain, the difference of their librations.

        Examples
        --------
        >>> from radioloc.lunar import LunarPosition
        >>> point = LunarPosition.from_selenographic(3.6285, 26.1334, -1922.9)
        >>> [round(x, 1) for x in point.to_frame("PA_DE440").xyz_m.tolist()]
        [1554678.2, 98094.5, 765005.8]
        """
        if frame == self.frame:
            _constants_of(frame)
            return self
        return LunarPosition(frame, rot_between(self.frame, frame) @ self.xyz_m)

    def to_axes(self, axes: str, constants: EphemerisConstants) -> LunarPosition:
        """Return the point in principal (``"PA"``) or mean-Earth (``"ME"``) axes of the ephemeris of these constants.

        A point in principal axes of another ephemeris is rotated by the mean-Earth axes that both share, as by
        :meth:`to_frame`; without shared axes it is an InputError.
        """
        frames = {"PA": f"PA_{constants.name}", "ME": constants.me_frame}
        if frames[axes] == self.frame:
            return self
        source = constants if self.frame in frames.values() else CONSTANTS.get(self.frame.removeprefix("PA_"))
        if source is None or source.me_frame != constants.me_frame:
            raise InputError(
                f"position: expected {frames['PA']} or {frames['ME']}, the axes of the kernels, got {self.frame}; "
                "convert the position"
            )
        return LunarPosition(
            frames[axes], _rotation(self.frame, source, frames[axes], constants) @ self.xyz_m
        )


def rot_between(frame: str, target: str) -> Floats:
    """Rotation from one Moon-fixed frame to another, shape (3, 3), as by :meth:`LunarPosition.to_frame`.

    Points of shape (n, 3) are converted by ``points_m @ rot_between(frame, target).T``.

    Parameters
    ----------
    frame, target : str
        ``"PA_DE421"``, ``"ME_DE421"``, ``"PA_DE440"``, ...

    Raises
    ------
    InputError
        The constants of an ephemeris are not known, or the mean-Earth axes of the two ephemerides differ.

    Examples
    --------
    >>> import numpy as np
    >>> from radioloc.lunar import rot_between
    >>> points_me_m = np.full((1_000_000, 3), [1737400.0, 0.0, 0.0])
    >>> points_pa_m = points_me_m @ rot_between("ME_DE421", "PA_DE440").T
    >>> points_pa_m[-1].round(1).tolist()
    [1737399.8, -571.5, 662.9]
    """
    constants, target_constants = _constants_of(frame), _constants_of(target)
    if constants.me_frame != target_constants.me_frame:
        raise InputError(
            f"the rotation from {frame} to {target} is not available: their mean-Earth axes differ"
        )
    return _rotation(frame, constants, target, target_constants)


def _rotation(
    frame: str, constants: EphemerisConstants, target: str, target_constants: EphemerisConstants
) -> Floats:
    """Return the rotation between axes of two ephemerides with the same mean-Earth axes."""
    to_me = np.eye(3) if frame == constants.me_frame else rot_pa_to_me(constants)
    return to_me if target == target_constants.me_frame else rot_pa_to_me(target_constants).T @ to_me


def _constants_of(frame: str) -> EphemerisConstants:
    _, _, ephemeris = frame.partition("_")
    if ephemeris not in CONSTANTS or not frame.startswith(("PA_", "ME_")):
        supported = ", ".join(f"PA_{name}, {constants.me_frame}" for name, constants in CONSTANTS.items())
        raise InputError(f"frame {frame!r} is not known; use one of {supported}")
    return CONSTANTS[ephemeris]
