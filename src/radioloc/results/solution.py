"""The result of locating a point on the Moon: where it is, how well that is known, and why."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import singledispatch
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from radioloc.constants import MEAN_LUNAR_RADIUS_M
from radioloc.errors import InputError
from radioloc.estimation.combination import Ellipse, ReferenceComparison, horizontal_ellipse
from radioloc.estimation.consider import (
    Consider,
    ErrorSource,
    error_budget,
    shared_prior_effects,
    span_record,
)
from radioloc.estimation.consistency_results import Consistency
from radioloc.estimation.gauss_markov import SeriesWeight, TimeCorrelation
from radioloc.estimation.observability import Observability
from radioloc.estimation.shared_observations import residual_sample
from radioloc.estimation.statistics import FitStatistics, Residuals, finite_or_none, read_only
from radioloc.estimation.status import FitStatus
from radioloc.lunar.local import EAST_NORTH_UP
from radioloc.lunar.position import LunarPosition
from radioloc.lunar.selenographic import cartesian_to_selenographic, east_north_up
from radioloc.parameters.parameter import ParameterSet
from radioloc.quantities import TableForm, as_table
from radioloc.results.cards import Card
from radioloc.results.result import Content, OrbitFile, Result
from radioloc.results.tables import by_axis, finite, place_record, residual_table
from radioloc.targets.orbit_state import OrbitState
from radioloc.units import set_fields
from radioloc.vectors import Floats, Mask

Axes = Literal["enu", "pa", "me", "geographic"]
Level = Literal["total", "scaled", "formal"]
_FILE_NAME = re.compile(r"[^\w-]")  # characters of a target's name that its files do not have
ORBIT_FILES = ("orbit.bsp", "orbit.oem", "orbit.opm")
"""Names of the files of an orbit that was determined."""


@singledispatch
def build_card(result: object) -> Card:
    """Return the card of a solution, as registered by :mod:`radioloc.results.solution_card`."""
    raise TypeError(f"expected a Solution, got a {type(result).__name__}")


@dataclass(frozen=True, slots=True, eq=False)
class TargetPosition:
    """Name of one of several targets, its position (3,), m, and d(position)/d(parameter) (3, p), principal axes."""

    name: str
    position_pa_m: Floats
    position_partials: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Solution(Result):
    """Result of a fit; arrays are read-only.

    Sigmas have three levels: ``"formal"`` from the stated sigmas; ``"scaled"`` by larger residuals and their time
    correlation; ``"total"`` with the errors of consider parameters and, for the position, the assumed ephemeris error.
    A sigma without a level is the total.
    """

    status: FitStatus  #: outcome of the fit
    message: str  #: reason of a failure or a remark, with numbers; may be empty
    parameters: ParameterSet  #: parameters with a-priori values
    values: Floats  #: (p,), estimated values
    #: (p, p), formal and scaled covariance; undetermined parameters have infinite variances.
    formal_covariance: Floats
    covariance: Floats  #: likewise
    noise_scale: float  #: factor on the stated sigmas in the scaled covariance
    pa_frame: str  #: names of the axes, such as ``"PA_DE421"`` and ``"ME_DE421"``
    me_frame: str  #: likewise
    #: (3,), estimated position in principal axes, m; of a target on a trajectory the offset from it, zeros.
    position_pa_m: Floats
    #: (3, p), d(position_pa)/d(parameter): the identity for cartesian parameters, zeros for others.
    position_partials: Floats
    rot_pa_to_me: Floats  #: (3, 3), rotation from principal to mean-Earth axes
    fit: FitStatistics  #: residual statistics
    residuals: Residuals  #: all observations
    observability: Observability  #: poorly determined and undetermined combinations
    name: str = "solution"  #: name of the study or the target
    #: (3,), assumed error of the position by ephemeris and orientation, east, north, up, m.
    ephemeris_sigma_enu_m: Floats = field(default_factory=lambda: np.zeros(3))
    #: Series with time-correlated residuals, and their contribution to the scaled covariance.
    time_correlation: TimeCorrelation | None = None
    #: Series with reduced weight, as their residuals are correlated in time.
    series_weights: tuple[SeriesWeight, ...] = ()
    iterations: int = 0  #: Gauss-Newton steps of the last fit
    fit_count: int = 1  #: number of fits during outlier rejection
    reference: ReferenceComparison | None = None  #: difference to a known position
    references: tuple[ReferenceComparison, ...] = ()  #: differences to further known positions
    notes: tuple[str, ...] = ()  #: sentences on the data and the model that call for an action
    #: Sentences on effects that are not modelled, and the sources of the media.
    limitations: tuple[str, ...] = ()
    #: Kernels with their hashes, tables, versions, settings.
    provenance: Mapping[str, Any] = field(default_factory=dict)
    #: Trajectory of a target that is not fixed to the Moon. Properties of the position then raise
    #: :class:`~radioloc.errors.InputError`.
    trajectory: str | None = None
    #: Estimated states of all spacecraft, by the names of the targets.
    states: Mapping[str, OrbitState] = field(default_factory=dict)
    consider: Consider | None = None  #: effects of the consider parameters on the estimate
    #: (p, p), change of the estimate by an error of one sigma of each a-priori value (columns).
    prior_effects: Floats = field(default_factory=lambda: np.zeros((0, 0)))
    #: Positions of several targets; the position of the solution is that of the first.
    targets: tuple[TargetPosition, ...] = ()
    #: Tests of groups of observations against all others.
    consistency: Consistency = field(default_factory=Consistency)

    def __post_init__(self) -> None:
        p = len(self.parameters)
        shapes = {
            "values": (p,),
            "formal_covariance": (p, p),
            "covariance": (p, p),
            "position_pa_m": (3,),
            "position_partials": (3, p),
            "rot_pa_to_me": (3, 3),
            "ephemeris_sigma_enu_m": (3,),
            "prior_effects": (p, p),
        }
        if not self.prior_effects.size:
            set_fields(self, prior_effects=np.zeros((p, p)))
        for name, shape in shapes.items():
            array = read_only(getattr(self, name))
            if array.shape != shape:
                raise InputError(f"{name}: expected shape {shape}, got {array.shape}")
            set_fields(self, **{name: array})

    @property
    def state(self) -> OrbitState | None:
        """Estimated state of the first spacecraft."""
        return next(iter(self.states.values()), None)

    @property
    def all_references(self) -> list[ReferenceComparison]:
        """Differences to all known positions, the reference first."""
        return [reference for reference in (self.reference, *self.references) if reference is not None]

    def of_target(self, name: str) -> Solution:
        """Return the solution with the position of one of several targets.

        Raises
        ------
        InputError
            The name is not that of a target.
        """
        for target in self.targets:
            if target.name == name:
                position_pa_m, partials = target.position_pa_m, target.position_partials
                located = replace(self, name=name, position_pa_m=position_pa_m, position_partials=partials)
                return replace(located, targets=(), reference=None, references=())
        names = ", ".join(target.name for target in self.targets)
        raise InputError(f"target: expected one of {names}, got {name!r}")

    @property
    def converged(self) -> bool:
        """True if the estimate can be used: fit and editing converged, and no test contradicts the position."""
        return self.status is FitStatus.CONVERGED

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
            See :class:`Solution`.

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
        considered = self.consider if level == "total" else None
        return self.covariance if considered is None else self.covariance + considered.covariance

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

    @property
    def correlation_factor(self) -> float:
        """Factor of the time correlation of residuals on the scaled sigma of the position."""
        if self.time_correlation is None or not self.position_determined:
            return 1.0
        root = self.position_partials
        correlated = float(np.trace(root @ self.time_correlation.added_covariance @ root.T))
        scaled = float((self.sigma_enu_m("scaled") ** 2).sum()) if correlated > 0.0 else 1.0
        return math.sqrt(scaled / (scaled - max(correlated, 0.0)))

    def to_dict(self) -> dict[str, Any]:
        """Return all numbers except single residuals, in types that JSON has; None for numbers that are not finite."""
        series = self.time_correlation.series if self.time_correlation else ()
        content: dict[str, Any] = {
            "name": self.name,
            "method": "tracking",
            "converged": self.converged,
            "status": self.status.value,
            "message": self.message,
            "trajectory": self.trajectory,
            "state": None if self.state is None else self.state.to_dict(),
            "states": {name: state.to_dict() for name, state in self.states.items() if len(self.states) > 1},
            **self._position_dict(),
            "biases": self._bias_dict("range_bias", "m"),
            "time_biases": self._bias_dict("time_bias", "s"),
            "parameters": self._parameter_rows(),
            "parameter_covariance": list(map(finite, self.covariance)),
            "fit": {
                **self.fit.to_dict(),
                "noise_scale": self.noise_scale,
                "correlation_factor": self.correlation_factor,
                "time_correlation": [asdict(item) for item in series],
                "series_weights": [
                    asdict(item) | {"weighed_as": item.weighed_as} for item in self.series_weights
                ],
                "iterations": self.iterations,
                "fit_count": self.fit_count,
            },
        }
        if self.targets:
            located = [self.of_target(target.name) for target in self.targets]
            content["targets"] = {item.name: item._position_dict() | item._error_rows() for item in located}
        content |= self._error_rows()
        content["observations"] = residual_sample(self.residuals)
        content["budget"] = [item.to_dict() for item in self.budget]
        return content | {
            "rejected": self.residuals.rejected(),
            "observability": self.observability.to_dict(),
            "consistency": self.consistency.to_list(),
            "with_findings": self._with_findings(),
            "reliability": [item.to_dict() for item in self.consistency.reliability],
            "reference": None if self.reference is None else self.reference.to_dict(),
            "references": [reference.to_dict() for reference in self.references],
            "notes": list(self.notes),
            "limitations": list(self.limitations),
            "provenance": dict(self.provenance),
        }

    def with_findings(self) -> Solution | None:
        """Return the position with the errors that the consistency tests find as parameters; None without findings.

        Only the position and its total covariance are those of the adapted estimate.
        """
        adapted = self.consistency.adapted
        if adapted is None or self.trajectory is not None:
            return None
        position_pa_m = self.position_pa_m + self.position_partials @ adapted.shift
        return replace(
            self,
            position_pa_m=position_pa_m,
            covariance=adapted.covariance,
            consider=None,
            consistency=Consistency(),
        )

    def _with_findings(self) -> dict[str, Any] | None:
        """Return the position with the findings as parameters, its sigma and its difference from the reported one."""
        adapted, solution = self.consistency.adapted, self.with_findings()
        if adapted is None or solution is None:
            return None
        return {
            "position": place_record(solution.me_frame, solution.selenographic, solution.position_me_m),
            "sigma": by_axis(EAST_NORTH_UP, solution.sigma_enu_m()),
            "shift": by_axis(EAST_NORTH_UP, self.enu_partials @ adapted.shift),
            "shift_sigmas": adapted.shift_sigmas,
        }

    def to_table(
        self, what: Literal["residuals", "parameters"] = "residuals", form: TableForm = "astropy"
    ) -> Any:
        """Return residuals or parameters as a table.

        Parameters
        ----------
        what : {"residuals", "parameters"}
            Content of the table. Units of parameters are in the column ``unit``.
        form : {"astropy", "pandas"}
            A ``QTable`` with units and ``Time``, or a ``DataFrame``.

        Raises
        ------
        InputError
            The content is neither residuals nor parameters.

        Examples
        --------
        >>> import radioloc
        >>> solution = radioloc.compute_residuals("examples/apollo15/apollo15.toml")
        >>> solution.to_table()["residual_m"].unit, solution.to_table("parameters", "pandas")["name"].tolist()
        (Unit("m"), ['position.x', 'position.y', 'position.z'])
        """
        if what == "parameters":
            rows = self._parameter_rows()
            columns = {key: [math.inf if row[key] is None else row[key] for row in rows] for key in rows[0]}
            return as_table(columns, form)
        if what != "residuals":
            raise InputError(f"table: expected residuals or parameters, got {what!r}")
        return self.residuals.to_table(form)

    def card(self) -> Card:
        """Return the card of the solution."""
        return build_card(self)

    @property
    def verdict(self) -> str:
        """Class of the status on the page: ``good``, ``failed``, or empty without a fit."""
        if not self.parameters.free.any():
            return ""
        return "good" if self.is_usable else "failed"

    def files(self) -> Mapping[str, Content]:
        """Return ``solution.json``, ``residuals.csv`` and the :data:`ORBIT_FILES` of estimated orbits."""
        files: dict[str, Content] = {
            "solution.json": self.to_dict(),
            "residuals.csv": residual_table(self.residuals),
        }
        for name, state in self.states.items() if self.converged else ():
            is_known = np.isfinite(state.covariance).all() and state.covariance.any()
            orbit = OrbitFile(state.orbit.integrate(), state.body, state.covariance if is_known else None)
            stem = f"orbits/{_FILE_NAME.sub('_', name)}" if len(self.states) > 1 else "orbit"
            files |= {f"{stem}{Path(file).suffix}": orbit for file in ORBIT_FILES}
        return files

    def positions(self) -> Mapping[str, Result]:
        """Return the solution itself, if it has a position that is estimated and determined."""
        if self.trajectory is not None or not (self.position_estimated and self.position_determined):
            return {}
        return {self.targets[0].name if self.targets else self.name: self}

    def __repr__(self) -> str:
        place = self.trajectory
        if place is None:
            longitude_deg, latitude_deg, height_m = self.selenographic
            place = f"{longitude_deg:.6f} deg E, {latitude_deg:.6f} deg N, {height_m:.1f} m ({self.me_frame})"
        return f"<Solution {self.name}: {place}, {'converged' if self.converged else 'NOT CONVERGED'}>"

    def _position_dict(self) -> dict[str, Any]:
        """Return the position with its sigmas and covariance; None for a trajectory."""
        if self.trajectory is not None:
            return {"position": None, "sigma": None, "covariance": None}
        levels: tuple[Level, ...] = ("scaled", "formal")
        axes: dict[str, Axes] = {"enu_m2": "enu", "pa_m2": "pa", "me_m2": "me"}
        axes["longitude_latitude_height_rad_rad_m"] = "geographic"
        return {
            "position": {
                "pa": {"frame": self.pa_frame, **by_axis("xyz", self.position_pa_m)},
                "me": place_record(self.me_frame, self.selenographic, self.position_me_m),
            },
            "sigma": {
                **by_axis(EAST_NORTH_UP, self.sigma_enu_m()),
                **{level: by_axis(EAST_NORTH_UP, self.sigma_enu_m(level)) for level in levels},
                "ephemeris": by_axis(EAST_NORTH_UP, self.ephemeris_sigma_enu_m),
            },
            "covariance": {
                key: list(map(finite, self.position_covariance(name))) for key, name in axes.items()
            },
        }

    def _bias_dict(self, kind: str, unit: str) -> dict[str, Any]:
        """Return the biases of a kind by station, or by station and pass with its first and last epoch."""
        biases: dict[str, Any] = {}
        for k, (scope, (value, sigma)) in zip(
            self.parameters.of_kind(kind), self.biases(kind).items(), strict=True
        ):
            biases[scope] = {f"value_{unit}": value, f"sigma_{unit}": finite_or_none(sigma)}
            if span_utc := self.parameters.parameters[k].span_utc:
                biases[scope] |= dict(zip(("first_utc", "last_utc"), span_utc, strict=True))
        return biases

    def _parameter_rows(self) -> list[dict[str, Any]]:
        levels: dict[str, Level] = {"total_sigma": "total", "sigma": "scaled", "formal_sigma": "formal"}
        sigmas = {key: self.sigmas(level) for key, level in levels.items()}
        return [
            {
                "name": item.name,
                "unit": item.unit,
                "value": float(self.values[k]),
                **{key: finite_or_none(values[k]) for key, values in sigmas.items()},
                "prior_value": item.prior_value,
                "prior_sigma": finite_or_none(item.prior_sigma),
                "fixed": item.fixed,
            }
            for k, item in enumerate(self.parameters)
        ]

    def _error_rows(self) -> dict[str, list[dict[str, Any]]]:
        """Return the shift of the position by one sigma of each consider parameter and a-priori value."""
        rows: dict[str, list[dict[str, Any]]] = {"priors": []}
        if self.consider is not None:
            partials = None if self.trajectory is not None else self.enu_partials
            rows["considered"] = self.consider.to_list(partials)
        if self.trajectory is not None or not self.position_determined:
            return rows
        shifts_m = self.enu_partials @ self.prior_effects
        rows["priors"] = [
            {"name": item.name, "unit": item.unit, "value": item.prior_value, "sigma": item.prior_sigma}
            | span_record(item)
            | {"position_enu_m": shifts_m[:, k].tolist()}
            for k, item in enumerate(self.parameters)
            if shifts_m[:, k].any()
            and not item.prior_errors  # others have shared errors, which are considered
        ]
        if shared := shared_prior_effects(self.parameters, self.prior_effects):
            rows.setdefault("considered", []).extend(
                {
                    "name": name,
                    "unit": "1",
                    "sigma": 1.0,
                    "position_enu_m": (self.enu_partials @ effect).tolist(),
                }
                for name, effect in shared.items()
            )
        return rows

    def _place_rad(self) -> tuple[float, float, float]:
        if self.trajectory is not None:
            raise InputError(
                f"{self.name}: expected a target fixed to the Moon, got a trajectory ({self.trajectory})"
            )
        longitude_rad, latitude_rad, height_m = cartesian_to_selenographic(self.position_me_m)
        return float(longitude_rad), float(latitude_rad), float(height_m)
