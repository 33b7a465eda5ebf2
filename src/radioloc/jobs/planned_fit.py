"""A fit without the values of its observations, as covariance planning needs it, and the error budget of its targets.

The observations are weighted by the inverse of their covariance, so that the estimate has the least variance (Aitken
1935). Errors of an orbit are mapped over the tracked arc and averaged.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import block_diag

from radioloc.errors import InputError
from radioloc.estimation.consider import Consider, UnestimatedErrors, error_budget, prior_effects, sensitivity
from radioloc.estimation.least_squares import FitResult
from radioloc.estimation.linearization import Linearization, covariance_matrix, factorize
from radioloc.estimation.observability import assess_observability
from radioloc.estimation.status import FitStatus
from radioloc.jobs.error_columns import GravityErrorOrbits, orbit_state, own_gravity_errors
from radioloc.jobs.problem import ArcPart
from radioloc.jobs.stochastic import IndependentAccelerations, StochasticProblem
from radioloc.parameters.parameter import ParameterSet, Role
from radioloc.parameters.rows import ObservationRows
from radioloc.results.covariance import PlannedArc
from radioloc.targets.design import DesignMatrix
from radioloc.targets.orbit_state import ALONG_ACROSS_RADIAL, OrbitState, along_across_radial
from radioloc.time import Epochs, tt_to_tdb, utc_to_tt
from radioloc.vectors import Floats, Indices, Mask

_MAPPED_STEP_S, _MIN_MAPPED_EPOCHS = 600.0, 13
"""Step and least number of epochs at which the covariance of an orbit is averaged: a dozen in a revolution."""


@dataclass(frozen=True, slots=True, eq=False)
class _WithProcess:
    """A linearization with the independent accelerations of the process noise as further parameters."""

    design: Linearization
    processes: Sequence[IndependentAccelerations]

    @property
    def residual_m(self) -> Floats:
        """Residuals, m, shape (n,)."""
        return self.design.residual_m

    def partials(self, rows: Indices) -> Floats:
        """d(computed)/d(parameter) of some observations, shape (m, p)."""
        return np.hstack([self.design.partials(rows), *(item.effects_m(rows) for item in self.processes)])


@dataclass(frozen=True, eq=False)
class PlannedFit:
    """A part of a plan, fitted with some of its observations and without their values."""

    part: ArcPart
    used: Mask
    orbits: GravityErrorOrbits  # with the considered errors of their gravity fields
    parameters: ParameterSet  # of the problem, then those of the process noise
    processes: Sequence[IndependentAccelerations] = ()
    design: DesignMatrix | None = None  # of the model at its a-priori parameters; computed if None

    @classmethod
    def from_arc(cls, part: ArcPart, usable: Mask, orbits: GravityErrorOrbits) -> PlannedFit:
        """Return the fit with all usable observations of the whole plan, (n,)."""
        problem = part.problem
        parameters, used = problem.model.parameters, usable[part.rows]
        if not problem.has_process_noise:
            return cls(part, used, orbits, parameters)
        stochastic = StochasticProblem.linearized_about(problem.model, parameters.prior_values)
        processes = IndependentAccelerations.from_problem(stochastic)
        added = [item for process in processes for item in process.parameters]
        return cls(part, used, orbits, ParameterSet([*parameters, *added]), processes)

    def with_observations(self, rows: Mask) -> PlannedFit:
        """Return the fit with some of its observations only."""
        return replace(self, used=rows & self.used)

    def with_fixed(self, *names: str) -> PlannedFit:
        """Return the fit with some of its parameters known without error."""
        items = [replace(item, role=Role.FIXED) if item.name in names else item for item in self.parameters]
        return replace(self, parameters=ParameterSet(items))

    @cached_property
    def unadjusted_errors(self) -> UnestimatedErrors:
        """Considered errors that are left out of the weights."""
        problem = self.part.problem
        return problem.unadjusted_errors(problem.model, problem.model.parameters.prior_values, self.orbits)

    @cached_property
    def fit(self) -> FitResult:
        """Covariance of all parameters, those of the process noise last."""
        problem, parameters = self.part.problem, self.parameters
        linearization: Linearization = self.design or problem.model.linearize(
            problem.model.parameters.prior_values
        )
        if self.processes:
            linearization = _WithProcess(linearization, self.processes)
        x, whitening = parameters.prior_values, problem.noise.whitener(self.used)
        factor = factorize(linearization, whitening, parameters, x)
        if factor is None:
            raise InputError("the partials of the observations are not finite numbers")
        determined = bool(factor.determined.all())
        return FitResult(
            parameters=parameters,
            x=x,
            covariance=covariance_matrix(factor, parameters),
            linearization=linearization,
            noise=problem.noise,
            used=self.used,
            chi2=0.0,
            dof=0,
            status=FitStatus.CONVERGED if determined else FitStatus.UNOBSERVABLE,
            iterations=0,
            factor=factor,
            whitening=whitening,
        )

    def planned(self, target: int = 0) -> PlannedArc:
        """Return the predicted accuracy of a target."""
        fit, part, model = self.fit, self.part, self.part.problem.model
        axes, count = model.targets[target].local_axes, int(fit.used.sum())
        partials = self._local_partials(target)
        involved = (partials != 0.0).any(axis=(0, 1))
        if not np.isfinite(np.diag(fit.covariance)[involved]).all():
            missing = assess_observability(fit).describe()[:1]
            return PlannedArc(part.hours, part.span_h, count, (), missing, axes)
        covariance = np.where(np.isfinite(fit.covariance), fit.covariance, 0.0)
        consider_effects = sensitivity(fit, self.unadjusted_errors)
        state = self._state(target, covariance, consider_effects) if axes == ALONG_ACROSS_RADIAL else None
        sources = error_budget(
            self.parameters,
            partials,
            partials @ covariance @ np.swapaxes(partials, -1, -2),
            prior_effects(fit),
            consider_effects,
            np.array(part.problem.choice.ephemeris_sigma_m),
            self._direct_effects_m(target, state, consider_effects),
        )
        return PlannedArc(part.hours, part.span_h, count, sources, (), axes, state)

    def _local_partials(self, target: int) -> Floats:
        """Return the partials of a target's position with respect to all parameters, along its axes, (q, 3, p)."""
        model = self.part.problem.model
        x, count = model.parameters.prior_values, len(model.parameters)
        by_model = model.local_partials(x, self._epochs, target)[:, :3]
        partials = np.zeros((len(by_model), 3, len(self.parameters)))
        partials[..., :count] = by_model
        for process in self.processes:
            if process.orbit.target == target:
                by_process = along_across_radial(
                    process.orbit.effects.orbit, self._epochs, process.states(self._epochs)
                )
                begin = count + process.first
                partials[..., begin : begin + process.count] = by_process[:, :3]
        return partials

    def _state(self, target: int, covariance: Floats, consider_effects: Consider) -> OrbitState:
        """Return the state of an orbit with its total covariance and that of the process noise."""
        model = self.part.problem.model
        x, count = model.parameters.prior_values, len(model.parameters)
        total = covariance + consider_effects.covariance
        state = orbit_state(model, target, x, total, consider_effects, self.orbits)
        process = next((item for item in self.processes if item.orbit.target == target), None)
        if process is None:
            return state
        columns, begin = model.columns_of(target), count + process.first
        by_x = model.targets[target].motion(x[columns])[1]
        chosen = np.r_[columns, begin : begin + process.count]
        onto = block_diag(by_x, np.eye(process.count))
        return replace(state, process=process.estimate(onto @ covariance[np.ix_(chosen, chosen)] @ onto.T))

    def _direct_effects_m(
        self, target: int, state: OrbitState | None, consider_effects: Consider
    ) -> Floats | float:
        """Return the effects (q, 3, c) of errors that move the true orbit, and not only the estimate."""
        if state is None:
            return 0.0
        effects = np.zeros((len(self._epochs), 3, len(consider_effects.parameters)))
        model = self.part.problem.model
        of_gravity = own_gravity_errors(consider_effects.parameters, self.orbits, model, target)
        moved = (state.disturbed or state.orbit).effects(self._epochs)
        effects[..., of_gravity] = -along_across_radial(state.orbit, self._epochs, moved)[:, :3]
        return effects

    @property
    def _epochs(self) -> Epochs:
        epochs: Epochs = self.part.problem.model.rows.evaluate(_mapped_epochs)
        return epochs


def _mapped_epochs(rows: ObservationRows) -> Epochs:
    """Return epochs all over the tracked part of an orbit, TDB."""
    ends = tt_to_tdb(utc_to_tt(rows.observations.span()))
    length_s = float(ends[1].seconds_since(ends[0])[0])
    count = max(_MIN_MAPPED_EPOCHS, int(length_s / _MAPPED_STEP_S) + 1)
    return ends[:1].shifted(np.linspace(0.0, length_s, count))
