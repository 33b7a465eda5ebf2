"""Gross mistakes in the data: a wrong time scale, sign, factor or station name.

Some observations of each link are predicted again for each hypothesis, and a linear fit is iterated. Its misfit is

    q = sum of min((residual / sigma)^2, k^2)

over n observations, with the limit k of the rejection. With the variance of the noise estimated for each hypothesis,
the logarithm of the likelihood ratio of two hypotheses is (n / 2) ln(q_2 / q_1). Hypotheses are tested only if the
residuals of a series as it is exceed their stated sigmas by far. Orbits start at their a-priori states for each
hypothesis, those of the data as they are also at the estimate: an orbit that fits these refutes any mistake.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from radioloc.constants import C_M_S, SECONDS_PER_DAY
from radioloc.ephemeris import EphemerisConstants
from radioloc.errors import ConvergenceError, InputError, RadiolocError
from radioloc.estimation.consistency_results import SIGNIFICANCE_LEVEL, ConsistencyTest
from radioloc.estimation.group_tests import chi2_log_p_value
from radioloc.estimation.status import Doubt
from radioloc.jobs.problem import EstimationProblem
from radioloc.lunar import rot_pa_to_me
from radioloc.measurements.evaluation import prepare_predictor
from radioloc.measurements.link import Link
from radioloc.measurements.observations import Observations
from radioloc.measurements.predictor import Predictor
from radioloc.measurements.ramps import DOWNLINK, UPLINK, turnaround_ratio
from radioloc.measurements.registry import KINDS, MEASUREMENTS, TIME_TAGS
from radioloc.parameters.columns import PASS_GAP_H
from radioloc.parameters.parameter import ParameterSet
from radioloc.results.build import AssessedFit
from radioloc.study.observation_choice import with_turnaround
from radioloc.study.study import Study
from radioloc.targets.design import ObservationModel
from radioloc.time import Epochs, utc_strings, utc_to_tai, utc_to_tt
from radioloc.vectors import Floats, Indices, Mask

_MAX_SERIES_OBSERVATIONS = 20  # of each link and type; a mistake acts on all of them
_MAX_SIGMAS = 5.0  # of a residual in the misfit, as in the rejection of outliers
_MIN_MISFIT_RATIO = 4.0  # of the data as they are to the best hypothesis: residuals twice as large
_MAX_ITERATED, _MAX_ITERATIONS = 8, 4  # hypotheses whose fit is iterated, linearizations of each
_ROBUST_ITERATIONS = 20  # of weights that make squares absolute values
_MIN_RELATIVE_INFORMATION = 1e-13  # keeps parameters that the data do not determine at their values
_TAG_ERRORS_S = {"1 s late": 1.0, "1 s early": -1.0, "a day late": 86400.0, "a day early": -86400.0}
_ZONES_H = {f"in local time, UTC{hours:+d} h": 3600.0 * hours for hours in range(-12, 15) if hours}
_TAI_MINUS_GPS_S = 19.0
_FACTORS = {
    "have the wrong sign": -1.0,
    "are half of the right ones": 2.0,
    "are twice the right ones": 0.5,
    "are in km, not m": 1e3,
}
_TAGS = dict(zip(TIME_TAGS, ("transmission", "reception", "bounce"), strict=True))
_PRESSURE_UNITS_HPA = {"mmHg": 1.333224, "kPa": 10.0, "inHg": 33.86389}
_MIN_RATIO_CHANGE = 0.01  # of turnaround ratios, which differ by 8 % and more
_MAX_PASSES = 12  # of a station with hypotheses of their own


@dataclass(frozen=True, slots=True, eq=False)
class Mistake:
    """Hypothesis on a mistake in some of n observations: corrected values, or other participants or time tags."""

    name: str  # sentence
    rows: Mask  # (n,)
    value_m: Floats | None = None  # (n,), corrected values
    corrected: Observations | None = None  # predicted in place of the rows


def _is_mostly_unused(problem: EstimationProblem, used: Mask) -> bool:
    """Return whether most of a series is not used: a target that is not seen, or counts of another signal."""
    order = problem.order
    total, count = (np.bincount(order.code, rows, len(order.series)) for rows in (None, used))
    return bool((2 * count < total).any())


def axes_mistakes(
    study: Study, assessed: AssessedFit, constants: EphemerisConstants
) -> Iterator[ConsistencyTest]:
    """Yield a finding for each stated place that agrees with the estimate in other lunar axes only."""
    estimate = assessed.estimate.with_findings() or assessed.estimate
    several = len(estimate.targets) > 1
    places = [("a-priori position", prior.target, prior.mean) for prior in study.estimate.position_priors]
    if not several:
        known_places = (() if study.reference is None else (study.reference,)) + study.references
        places += [(f"reference {item.name}", "", item.position) for item in known_places]
    rot = rot_pa_to_me(constants)
    for name, target, position in places:
        axes, turn = ("principal", rot) if position.frame.startswith("ME") else ("mean-Earth", rot.T)
        located = estimate.of_target(target) if several else estimate
        stated_m = position.to_axes("PA", constants).xyz_m
        information = np.linalg.pinv(located.position_covariance("pa"))
        stated, turned = (
            float(d @ information @ d)
            for d in (xyz - located.position_pa_m for xyz in (stated_m, turn @ stated_m))
        )
        log_p_value = chi2_log_p_value(stated, 3)
        if log_p_value < math.log(SIGNIFICANCE_LEVEL) <= chi2_log_p_value(turned, 3):
            text = f"the coordinates of the {name} are in {axes} axes"
            log10_p_value = log_p_value / math.log(10.0)
            yield ConsistencyTest("mistake", text, turned, 3, log10_p_value, next_chi2_ratio=stated / turned)


def find_mistake(
    problem: EstimationProblem, assessed: AssessedFit, doubts: Sequence[Doubt]
) -> ConsistencyTest | None:
    """Return the mistake that explains the observations of a fit; None without any.

    A fit without doubts and findings is examined only if it does not use most of a series.
    """
    edited, findings = assessed.edited, assessed.consistency.findings
    if problem.is_fixed or problem.has_process_noise:
        return None
    if edited.converged and not (doubts or findings) and not _is_mostly_unused(problem, edited.fit.used):
        return None
    rows = _sample(problem)
    predictor, sigma_m = problem.predictor.select(rows), problem.noise.sigma_m[rows]
    count = len(rows)
    predictions = _Predictions(problem, predictor, sigma_m, edited.fit.x)
    stated = predictions.squares(None)
    code = problem.order.code[rows]
    sums, sizes = np.bincount(code, stated), np.bincount(code)
    if not (sums > _MIN_MISFIT_RATIO * sizes).any():
        return None
    first = sorted(mistakes(predictor.observations), key=predictions.first_misfit)[:_MAX_ITERATED]
    squares = {item.name: predictions.squares(item) for item in first}
    misfits = sorted((float(values.sum()), name) for name, values in squares.items())
    smallest, name = misfits[0]
    changed = next(item.rows for item in first if item.name == name)
    if not stated[changed].sum() > _MIN_MISFIT_RATIO * squares[name][changed].sum():
        return None
    if problem.model.orbit_indices and smallest > _MIN_MISFIT_RATIO * count:
        return None
    max_ratio = SIGNIFICANCE_LEVEL ** (-2.0 / count)
    alternatives = [(misfit, text) for misfit, text in misfits[1:] if misfit < max_ratio * smallest]
    return ConsistencyTest(
        "mistake",
        name,
        smallest,
        count,
        -0.5 * count * math.log10(stated.sum() / smallest),
        alternatives=tuple(
            ConsistencyTest("mistake", text, misfit, count, 0.0) for misfit, text in alternatives
        ),
        next_chi2_ratio=min(misfits[1][0], stated.sum()) / smallest,
    )


def mistakes(observations: Observations) -> Iterator[Mistake]:
    """Yield hypotheses on the observations of an arc."""
    links, count = observations.links, len(observations)
    present = {k: links[k] for k in np.unique(observations.link).tolist()}
    stations = sorted({name for link in present.values() for name in link.stations})
    receivers = np.array([link.receiver for link in links])[observations.link]
    owners = [("all stations", np.ones(count, dtype=bool))]
    owners += [(name, receivers == name) for name in stations if len(stations) > 1]
    owners = [(name, rows) for name, rows in owners if rows.any()]
    tag_errors_s: dict[str, float | Floats] = {
        **_TAG_ERRORS_S,
        **_ZONES_H,
        **dict(_ahead_of_utc_s(observations.epoch)),
    }
    for text, ahead_s in tag_errors_s.items():
        epoch = observations.epoch
        utc = Epochs(epoch.jd, epoch.fraction - ahead_s / SECONDS_PER_DAY, "UTC")  # of clocks that are ahead
        earlier = replace(observations, epoch=utc)
        for owner, rows in owners:
            yield Mistake(f"the time tags of {owner} are {text}", rows, corrected=earlier)
    for event, (tag, text) in enumerate(_TAGS.items()):
        possible = np.array([tag in MEASUREMENTS[kind].tags for kind in KINDS])[observations.kind]
        for owner, rows in owners:
            changed = rows & possible & (observations.tag != event) & ~observations.ramped
            if changed.any():
                corrected = replace(observations, tag=np.where(changed, np.int8(event), observations.tag))
                yield Mistake(f"the time tags of {owner} are times of {text}", changed, corrected=corrected)
    with_pressure = np.isfinite(observations.pressure_hpa)
    for unit, hpa in _PRESSURE_UNITS_HPA.items() if with_pressure.any() else ():
        corrected = replace(observations, pressure_hpa=hpa * observations.pressure_hpa)
        yield Mistake(f"the pressures are in {unit}, not hPa", with_pressure, corrected=corrected)
    for owner, rows in owners:
        for kind in np.unique(observations.kind[rows]).tolist():
            values = f"the {KINDS[kind]} values of {owner}"
            of_kind = rows & (observations.kind == kind)
            parts = [
                (values, of_kind),
                *((f"{values} {span}", part) for span, part in _passes(observations, of_kind)),
            ]
            for (name, part), (text, factor) in itertools.product(parts, _FACTORS.items()):
                yield Mistake(f"{name} {text}", part, factor * observations.value_m)
    yield from _turnaround_mistakes(observations, owners)
    if np.isfinite(observations.count_s).any():
        for text, factor in (("half of the right ones", 2.0), ("twice the right ones", 0.5)):
            corrected = replace(observations, count_s=factor * observations.count_s)
            rows = np.isfinite(observations.count_s)
            yield Mistake(f"the count intervals are {text}", rows, corrected=corrected)
    for first, second in itertools.combinations(stations, 2):
        exchanged = {first: second, second: first}
        renamed = [_renamed(link, exchanged) for link in links]
        rows = np.array([a != b for a, b in zip(links, renamed, strict=True)])[observations.link]
        corrected = replace(observations, links=tuple(renamed))
        yield Mistake(f"the stations {first} and {second} are exchanged", rows, corrected=corrected)
    for k, link in present.items():
        if link.transmitter and link.transmitter != link.receiver:
            turned = replace(link, transmitter=link.receiver, receiver=link.transmitter)
            corrected = replace(observations, links=(*links[:k], turned, *links[k + 1 :]))
            yield Mistake(
                f"transmitter and receiver of {link.path} are exchanged",
                observations.link == k,
                corrected=corrected,
            )


def _turnaround_mistakes(observations: Observations, owners: list[tuple[str, Mask]]) -> Iterator[Mistake]:
    """Yield hypotheses on the turnaround ratio by which Doppler follows from received frequencies."""
    stated = 1e6 * C_M_S / (observations.wavelength_um * observations.uplink_hz)
    is_doppler = (observations.kind == KINDS.index("doppler")) & np.isfinite(stated)
    for up, down in itertools.product(UPLINK, DOWNLINK):
        ratio, value_m = turnaround_ratio(up, down), observations.value_m.copy()
        is_other = is_doppler & (abs(stated / float(ratio) - 1.0) > _MIN_RATIO_CHANGE)
        if not is_other.any():
            continue
        index = np.flatnonzero(is_other)
        value_m[index] = with_turnaround(observations, index, float(ratio))
        for owner, rows in owners:
            if (changed := rows & is_other).any():
                of_owner = f"the turnaround ratio of Doppler of {owner}"
                yield Mistake(f"{of_owner} is {ratio}, not {stated[changed][0]:.6g}", changed, value_m)


@dataclass(frozen=True, slots=True, eq=False)
class _Predictions:
    """Predictions of a part of an arc for several hypotheses."""

    problem: EstimationProblem
    predictor: Predictor
    sigma_m: Floats  # (n,)
    x: Floats  # estimate of the observations as they are
    # By the identity of the corrected observations, and of the models, which are linearized at the a-priori values
    models: dict[int, ObservationModel | None] = field(default_factory=dict)
    start: dict[int, _Linear] = field(default_factory=dict)

    def first_misfit(self, mistake: Mistake) -> float:
        """Sum of absolute residuals over sigmas after one step, for the order of hypotheses."""
        return float(np.sqrt(self._squares(mistake, 1)).sum())

    def squares(self, mistake: Mistake | None) -> Floats:
        """Bounded squares (n,) of residuals over sigmas, corrected for a mistake."""
        return np.minimum(self._squares(mistake, _MAX_ITERATIONS), _MAX_SIGMAS**2)

    def _squares(self, mistake: Mistake | None, iterations: int) -> Floats:
        """Squares (n,) after some steps; infinite without a prediction."""
        model = self._model(None)
        corrected_model = (
            model if mistake is None or mistake.corrected is None else self._model(mistake.corrected)
        )
        squares = np.full(len(self.sigma_m), math.inf)
        if model is None or corrected_model is None:
            return squares
        # Other time tags are predicted for all rows; other parameters, as of nights, have no common model.
        corrected = None if mistake is None else mistake.corrected
        is_mixed = corrected is not None and corrected.epoch is not self.predictor.observations.epoch
        if is_mixed and corrected_model.parameters.names != model.parameters.names:
            return squares
        x = corrected_model.parameters.prior_values.copy()
        # The estimate may be far from the a-priori orbit.
        for k in model.orbit_indices if mistake is None else ():
            x[model.columns_of(k)] = self.x[self.problem.model.columns_of(k)]
        for iteration in range(iterations):
            try:
                is_start = iteration == 0 and mistake is not None
                linear = self._linear(corrected_model, x, is_start)
                if is_mixed and mistake is not None:
                    linear = linear.mixed(self._linear(model, x, is_start), mistake.rows)
            except (ConvergenceError, InputError):  # steps that led far from the Moon, or into it
                return np.full(len(self.sigma_m), math.inf)
            if mistake is not None and mistake.value_m is not None:
                value_m = self.predictor.observations.value_m
                change_m = np.where(mistake.rows, mistake.value_m - value_m, 0.0)
                linear = replace(linear, residual_m=linear.residual_m + change_m)
            step, squares = _robust_step(linear, self.sigma_m, corrected_model.parameters, x)
            x = x + step
        return squares

    def _model(self, corrected: Observations | None) -> ObservationModel | None:
        if id(corrected) not in self.models:
            self.models[id(corrected)] = self._prepared(corrected)
        return self.models[id(corrected)]

    def _prepared(self, corrected: Observations | None) -> ObservationModel | None:
        predictor = self.predictor
        try:
            if corrected is not None:
                predictor = prepare_predictor(
                    predictor.model,
                    corrected,
                    predictor.motions,
                    "auto",
                    predictor.targets,
                    predictor.more_partials,
                )
            return EstimationProblem.from_study(
                self.problem.study, predictor, self.problem.choice.restricted_to(predictor)
            ).model
        except RadiolocError:  # such as an epoch before the first one of a table
            return None

    def _linear(self, model: ObservationModel, x: Floats, is_start: bool) -> _Linear:
        if not is_start:
            return _Linear.from_model(model, x)
        if id(model) not in self.start:
            self.start[id(model)] = _Linear.from_model(model, x)
        return self.start[id(model)]


@dataclass(frozen=True, slots=True, eq=False)
class _Linear:
    """Observation model of n observations linearized by p parameters."""

    residual_m: Floats  # (n,)
    partials: Floats  # (n, p)
    usable: Mask  # (n,)

    @classmethod
    def from_model(cls, model: ObservationModel, x: Floats) -> _Linear:
        design, rows = model.linearize(x), np.arange(len(model.predictor.observations))
        return cls(design.residual_m, design.partials(rows), design.prediction.rows(rows).usable)

    def mixed(self, unchanged: _Linear, rows: Mask) -> _Linear:
        """Return the rows of this model in another one, (n,)."""
        return _Linear(
            np.where(rows, self.residual_m, unchanged.residual_m),
            np.where(rows[:, None], self.partials, unchanged.partials),
            np.where(rows, self.usable, unchanged.usable),
        )


def _robust_step(
    linear: _Linear, sigma_m: Floats, parameters: ParameterSet, x: Floats
) -> tuple[Floats, Floats]:
    """Return the step of p parameters with nearly the least sum of absolute residuals, and the squares (n,)."""
    free, sigmas = parameters.free, parameters.prior_sigmas
    residual = np.where(linear.usable, linear.residual_m / sigma_m, 0.0)
    partials = np.where(linear.usable[:, None], linear.partials[:, free] / sigma_m[:, None], 0.0)
    scale = np.sqrt(np.square(partials).sum(axis=0) + sigmas[free] ** -2.0)
    scale[scale == 0.0] = 1.0
    scaled, prior_weight = partials / scale, (sigmas[free] * scale) ** -2.0
    prior = prior_weight * ((parameters.prior_values - x)[free] * scale)
    step, remaining = np.zeros(len(x)), residual
    weights = np.ones(len(residual))
    for _ in range(_ROBUST_ITERATIONS):
        weighted = weights[:, None] * scaled
        normal = scaled.T @ weighted + np.diag(prior_weight + _MIN_RELATIVE_INFORMATION)
        step[free] = np.linalg.solve(normal, weighted.T @ residual + prior) / scale
        remaining = residual - partials @ step[free]
        weights = 1.0 / np.maximum(np.abs(remaining), 1.0)
    return step, np.where(linear.usable, remaining**2, _MAX_SIGMAS**2)


def _passes(observations: Observations, rows: Mask) -> Iterator[tuple[str, Mask]]:
    """Yield the interval, in words, and the rows (n,) of each of a few passes of some rows."""
    index = np.flatnonzero(rows)
    index = index[np.argsort(observations.epoch.mjd[index], kind="stable")]
    ends = 1 + np.flatnonzero(24.0 * np.diff(observations.epoch.mjd[index]) > PASS_GAP_H)
    if not 0 < len(ends) < _MAX_PASSES:
        return
    for part in np.split(index, ends):
        first, last = utc_strings(observations.epoch[part[[0, -1]]], decimals=0)
        mask = np.zeros(len(observations), dtype=bool)
        mask[part] = True
        yield f"from {first} to {last}", mask


def _renamed(link: Link, names: Mapping[str, str]) -> Link:
    transmitter, receiver = (names.get(name, name) for name in (link.transmitter, link.receiver))
    return replace(link, transmitter=transmitter, receiver=receiver)


def _sample(problem: EstimationProblem) -> Indices:
    """Return evenly spaced observations of each link and type, in order of the table."""
    order = problem.order
    series = np.split(order.order, np.flatnonzero(np.diff(order.code[order.order])) + 1)
    places = (np.linspace(0, len(rows) - 1, min(len(rows), _MAX_SERIES_OBSERVATIONS)) for rows in series)
    return np.sort(
        np.concatenate([rows[np.round(k).astype(int)] for rows, k in zip(series, places, strict=True)])
    )


def _ahead_of_utc_s(epoch: Epochs) -> Iterator[tuple[str, Floats]]:
    """Yield the time by which other time scales are ahead of UTC at epochs (n,), s, with words."""
    tai, tt = utc_to_tai(epoch), utc_to_tt(epoch)
    for name, at in {"TAI": tai, "GPS time": tai.shifted(-_TAI_MINUS_GPS_S), "TT or TDB": tt}.items():
        ahead_s = SECONDS_PER_DAY * ((at.jd - epoch.jd) + (at.fraction - epoch.fraction))
        yield f"{name}, not UTC ({ahead_s[0]:.6g} s ahead)", ahead_s
