"""The result of locating a point on the Moon: where it is, how well that is known, and why."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import singledispatch
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np

from radioloc.errors import InputError
from radioloc.estimation.combination import ReferenceComparison
from radioloc.estimation.consider import shared_prior_effects, span_record
from radioloc.estimation.consistency_results import Consistency
from radioloc.estimation.gauss_markov import SeriesWeight, TimeCorrelation
from radioloc.estimation.observability import Observability
from radioloc.estimation.shared_observations import residual_sample
from radioloc.estimation.statistics import FitStatistics, Residuals, finite_or_none
from radioloc.estimation.status import FitStatus
from radioloc.lunar.local import EAST_NORTH_UP
from radioloc.quantities import TableForm, as_table
from radioloc.results.cards import Card
from radioloc.results.estimate import Axes, Level, LocatedEstimate
from radioloc.results.result import Content, OrbitFile, Result
from radioloc.results.tables import by_axis, finite, place_record, residual_table
from radioloc.targets.orbit_state import OrbitState

_FILE_NAME = re.compile(r"[^\w-]")  # characters of a target's name that its files do not have
ORBIT_FILES = ("orbit.bsp", "orbit.oem", "orbit.opm")
"""Names of the files of an orbit that was determined."""


@singledispatch
def build_card(result: object) -> Card:
    """Return the card of a solution, as registered by :mod:`radioloc.results.solution_card`."""
    raise TypeError(f"expected a Solution, got a {type(result).__name__}")


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Solution(LocatedEstimate, Result):
    """Result of a fit: the estimate, its status and residuals, and the tests of these."""

    status: FitStatus  #: outcome of the fit
    message: str  #: reason of a failure or a remark, with numbers; may be empty
    noise_scale: float  #: factor on the stated sigmas in the scaled covariance
    fit: FitStatistics  #: residual statistics
    residuals: Residuals  #: all observations
    observability: Observability  #: poorly determined and undetermined combinations
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
    #: Estimated states of all spacecraft, by the names of the targets.
    states: Mapping[str, OrbitState] = field(default_factory=dict)
    #: Tests of groups of observations against all others.
    consistency: Consistency = field(default_factory=Consistency)

    @property
    def state(self) -> OrbitState | None:
        """Estimated state of the first spacecraft."""
        return next(iter(self.states.values()), None)

    @property
    def all_references(self) -> list[ReferenceComparison]:
        """Differences to all known positions, the reference first."""
        return [reference for reference in (self.reference, *self.references) if reference is not None]

    def of_target(self, name: str) -> Self:
        """Return the solution with the position of one of several targets, without differences to known positions.

        Raises
        ------
        InputError
            The name is not that of a target.
        """
        return replace(LocatedEstimate.of_target(self, name), reference=None, references=())

    @property
    def converged(self) -> bool:
        """True if the estimate can be used: fit and editing converged, and no test contradicts the position."""
        return self.status is FitStatus.CONVERGED

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
            content["targets"] = {
                place.name: place._position_dict() | place._error_rows() for place in self.places
            }
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

    def _with_findings(self) -> dict[str, Any] | None:
        """Return the position with the findings as parameters, its sigma and its difference from the reported one."""
        adapted, solution = self.adapted, self.with_findings()
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
        if self.consider.parameters:
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
