"""Estimate of a fit with the position of its target: coordinates, covariances, error budget."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Literal, Self, get_args

import numpy as np

from radioloc.constants import MEAN_LUNAR_RADIUS_M
from radioloc.errors import InputError
from radioloc.estimation.adaptation import AdaptedEstimate
from radioloc.estimation.combination import Ellipse, horizontal_ellipse
from radioloc.estimation.consider import Consider, ErrorSource, ReportedEstimate, error_budget
from radioloc.estimation.statistics import read_only
from radioloc.lunar.position import LunarPosition
from radioloc.lunar.selenographic import cartesian_to_selenographic, east_north_up
from radioloc.parameters.parameter import ParameterSet
from radioloc.units import set_fields
from radioloc.vectors import Floats, Mask

Axes = Literal["enu", "pa", "me", "geographic"]
Level = Literal["total", "scaled", "formal"]


@dataclass(frozen=True, slots=True, eq=False)
class TargetPosition:
    """Name of one of several targets, its position (3,), m, and d(position)/d(parameter) (3, p), principal axes."""

    name: str
    position_pa_m: Floats
    position_partials: Floats


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class LocatedEstimate(ReportedEstimate):
    """Reported estimate of a fit, with the positions of its targets; arrays are read-only.

    Sigmas have three levels: ``"formal"`` from the stated sigmas; ``"scaled"`` by larger residuals and their time
    correlation; ``"total"`` with the errors of consider parameters and, for the position, the assumed ephemeris error.
    A sigma without a level is the total.
    """

    name: str = "solution"  #: name of the study or the target
    pa_frame: str  #: names of the axes, such as ``"PA_DE421"`` and ``"ME_DE421"``
    me_frame: str  #: likewise
    #: (3,), estimated position in principal axes, m; of a target on a trajectory the offset from it, zeros.
    position_pa_m: Floats
    #: (3, p), d(position_pa)/d(parameter): the identity for cartesian parameters, zeros for others.
    position_partials: Floats
    rot_pa_to_me: Floats  #: (3, 3), rotation from principal to mean-Earth axes
    #: (3,), assumed error of the position by ephemeris and orientation, east, north, up, m.
    ephemeris_sigma_enu_m: Floats = field(default_factory=lambda: np.zeros(3))
    #: Trajectory of a target that is not fixed to the Moon. Properties of the position then raise
    #: :class:`~radioloc.errors.InputError`.
    trajectory: str | None = None
    #: Positions of several targets; :attr:`position_pa_m` is that of the first.
    targets: tuple[TargetPosition, ...] = ()
    #: Estimate with the findings of the consistency tests as parameters.
    adapted: AdaptedEstimate | None = None

    def __post_init__(self) -> None:
        p, shapes = len(self.parameters), dict[str, tuple[int, ...]]()
        shapes |= {"values": (p,), "position_pa_m": (3,), "ephemeris_sigma_enu_m": (3,)}
        shapes |= {"position_partials": (3, p), "rot_pa_to_me": (3, 3)}
        shapes |= dict.fromkeys(("formal_covariance", "covariance", "prior_effects"), (p, p))
        for name, shape in shapes.items():
            array = read_only(getattr(self, name))
            if array.shape != shape:
                raise InputError(f"{name}: expected shape {shape}, got {array.shape}")
            set_fields(self, **{name: array})

    @property
    def places(self) -> list[Self]:
        """Estimates with the position of each target."""
        return [self.of_target(target.name) for target in self.targets] or [self]

    def of_target(self, name: str) -> Self:
        """Return the estimate with the position of one of several targets.

        Raises
        ------
        InputError
            The name is not that of a target.
        """
        targets = {target.name: target for target in self.targets}
        if name not in targets:
            raise InputError(f"target: expected one of {', '.join(targets)}, got {name!r}")
        position_pa_m, partials = targets[name].position_pa_m, targets[name].position_partials
        return replace(self, name=name, position_pa_m=position_pa_m, position_partials=partials, targets=())

    @property
    def position_me_m(self) -> Floats:
        """:attr:`position_pa_m` in mean-Earth axes, m, shape (3,)."""
        return np.asarray(self.rot_pa_to_me @ self.position_pa_m)

    @property
    def position(self) -> LunarPosition:
        """Position in mean-Earth axes; :meth:`LunarPosition.to_frame` converts it.

        Examples
        --------
        >>> import radioloc
        >>> radioloc.compute_residuals("examples/apollo15/apollo15.toml").position
        <LunarPosition 3.500000 deg E, 26.000000 deg N, -1000.0 m (ME_DE421)>
        """
        self._place_rad()  # raises an error for a trajectory
        return LunarPosition(self.me_frame, self.position_me_m)

    @property
    def selenographic(self) -> tuple[float, float, float]:
        """East longitude and latitude in mean-Earth axes, deg, and height above the 1737.4 km sphere, m."""
        longitude_rad, latitude_rad, height_m = self._place_rad()
        return math.degrees(longitude_rad), math.degrees(latitude_rad), height_m

    @property
    def rot_pa_to_enu(self) -> Floats:
        """Rotation from principal axes to east, north, up at the position, shape (3, 3)."""
        longitude_rad, latitude_rad, _ = self._place_rad()
        return np.asarray(east_north_up(longitude_rad, latitude_rad) @ self.rot_pa_to_me)

    @property
    def enu_partials(self) -> Floats:
        """d(position east, north, up)/d(parameter), shape (3, p)."""
        return np.asarray(self.rot_pa_to_enu @ self.position_partials)

    def with_findings(self) -> Self | None:
        """Return the position with the errors that the consistency tests find as parameters; None without findings.

        Only the position and its total covariance are those of the adapted estimate.
        """
        if self.adapted is None or self.trajectory is not None:
            return None
        position_pa_m = self.position_pa_m + self.position_partials @ self.adapted.shift
        none = Consider(ParameterSet([]), np.zeros((len(self.parameters), 0)))
        covariance = self.adapted.covariance
        return replace(self, position_pa_m=position_pa_m, covariance=covariance, consider=none, adapted=None)

    @property
    def _involved(self) -> Mask:
        """Mask of the parameters on which the position depends, shape (p,)."""
        return np.asarray((self.position_partials != 0.0).any(axis=0))

    @property
    def position_estimated(self) -> bool:
        """True if the position was estimated, not fixed."""
        return bool((self._involved & self.parameters.free).any())

    @property
    def position_determined(self) -> bool:
        """True if all parameters on which the position depends are determined."""
        return bool(np.isfinite(np.diag(self.covariance)[self._involved]).all())

    def position_covariance(self, axes: Axes = "enu", level: Level = "total") -> Floats:
        """Covariance of the position, shape (3, 3).

        Parameters
        ----------
        axes : {"enu", "pa", "me", "geographic"}
            East, north, up at the position; x, y, z in principal or mean-Earth axes, m^2; or longitude,
            latitude, height in rad, rad, m.
        level : {"total", "scaled", "formal"}
            See :class:`LocatedEstimate`.

        Returns
        -------
        ndarray, shape (3, 3)
            Infinite on the diagonal where the position is not determined.

        Raises
        ------
        InputError
            Axes or level are not known, or the target has no position.
        """
        _, latitude_rad, height_m = self._place_rad()
        if level not in get_args(Level):
            raise InputError(f"level: expected total, scaled or formal, got {level!r}")
        if axes not in get_args(Axes):
            raise InputError(f"axes: expected enu, pa, me or geographic, got {axes!r}")
        if not self.position_determined:
            return np.diag([np.inf, np.inf, np.inf])
        # Parameters without part in the position may have infinite variances; they must not meet the zeros here.
        involved = self._involved
        root = self.enu_partials[:, involved]
        in_enu = root @ self.parameter_covariance(level)[np.ix_(involved, involved)] @ root.T
        if level == "total":
            in_enu = in_enu + np.diag(self.ephemeris_sigma_enu_m**2)
        radius_m = MEAN_LUNAR_RADIUS_M + height_m
        from_enu = {
            "enu": np.eye(3),
            "pa": self.rot_pa_to_enu.T,
            "me": self.rot_pa_to_me @ self.rot_pa_to_enu.T,
            "geographic": np.diag([1.0 / (radius_m * math.cos(latitude_rad)), 1.0 / radius_m, 1.0]),
        }[axes]
        covariance: Floats = from_enu @ in_enu @ from_enu.T
        return 0.5 * (covariance + covariance.T)

    def sigma_enu_m(self, level: Level = "total") -> Floats:
        """Return standard deviations east, north, up, m, shape (3,); infinite where not determined."""
        return np.sqrt(np.diag(self.position_covariance("enu", level)))

    def sigmas(self, level: Level = "total") -> Floats:
        """Return standard deviations of the parameters, shape (p,); infinite where not determined."""
        return np.sqrt(np.diag(self.parameter_covariance(level)))

    def parameter_covariance(self, level: Level = "total") -> Floats:
        """Return the covariance of the parameters, shape (p, p); undetermined parameters have infinite variances.

        The total includes consider parameters, not the assumed error of the ephemeris.
        """
        if level == "formal":
            return self.formal_covariance
        return self.covariance + self.consider.covariance if level == "total" else self.covariance

    def ellipse(self, probability: float = 0.95, level: Level = "total") -> Ellipse | None:
        """Return the horizontal error ellipse of a probability; None if not determined."""
        horizontal = self.position_covariance("enu", level)[:2, :2]
        if not np.isfinite(horizontal).all():
            return None
        return horizontal_ellipse(horizontal, probability)

    def biases(self, kind: str = "range_bias") -> dict[str, tuple[float, float]]:
        """Return value and sigma of each parameter of a kind, by station."""
        sigmas = self.sigmas()
        return {
            self.parameters.names[k].partition(".")[2]: (float(self.values[k]), float(sigmas[k]))
            for k in self.parameters.of_kind(kind)
        }

    @property
    def budget(self) -> tuple[ErrorSource, ...]:
        """Sources of the position's total sigma, the largest first; empty if it is fixed or not determined.

        The squares add up to those of :meth:`sigma_enu_m`.
        """
        if self.trajectory is not None or not (self.position_estimated and self.position_determined):
            return ()
        items = error_budget(
            self.parameters,
            self.enu_partials,
            self.position_covariance("enu", "scaled"),
            self.prior_effects,
            self.consider,
            self.ephemeris_sigma_enu_m,
        )
        return tuple(item for item in items if item.total_m > 0.0)

    def _place_rad(self) -> tuple[float, float, float]:
        if self.trajectory is not None:
            raise InputError(
                f"{self.name}: expected a target fixed to the Moon, got a trajectory ({self.trajectory})"
            )
        longitude_rad, latitude_rad, height_m = cartesian_to_selenographic(self.position_me_m)
        return float(longitude_rad), float(latitude_rad), float(height_m)
