"""Who does not fit: stations, links, passes and types against the rest, a-priori values, steps and offsets in time.

Each group of observations is taken out of the fit by parameters of its own, and the estimate without it is held against
the one with it. Then explanations are tried by :mod:`~radioloc.estimation.group_tests`: an a-priori value that is wrong
(of a bias, or of a considered parameter such as a station's place), a step of a link or of all baselines of a station
at the epoch that fits best, an offset of a link in one pass or throughout. The chance of each allows for the number of
those that were tried (Bonferroni). The best one joins the parameters and the search goes on until nothing is left.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radioloc.constants import C_M_S
from radioloc.estimation.consider import ConsideredErrors
from radioloc.estimation.editing import EditedFit
from radioloc.estimation.gauss_markov import TimeCorrelation
from radioloc.estimation.group_tests import BinnedProblem, Verdict, log_probability
from radioloc.estimation.labels import USED
from radioloc.estimation.least_squares import FitResult
from radioloc.estimation.series import SeriesOrder
from radioloc.estimation.time_correlation import noise_of_each
from radioloc.parameters.columns import PASS_GAP_H
from radioloc.time import Epochs, utc_strings

_Floats = NDArray[np.float64]

CHANCE = 1e-3
"""An inconsistency is told that occurs by chance in fewer than one solution of a thousand."""
_SIMPLER = 0.01
"""Components are left out of an explanation that chance makes as large in more cases than that."""
_MOST_KEPT = 0.5
"""Part of a series below which what is left of it does not stand for it."""
_FAMILIES = 4
"""Groups, a-priori values, steps, offsets."""
_MOST_FOUND = 3
_MOST_GROUPS = 200
_FEWEST = 3
"""Points on either side of a step."""


@dataclass(frozen=True, slots=True)
class Inconsistency:
    """A group of observations, or an explanation, and how it fits the rest.

    Parameters
    ----------
    kind : str
        What is tested: ``"station"``, ``"link"``, ``"type"`` or ``"pass"``, taken out of the fit; ``"a priori"``, a
        value set free; ``"jump"`` or ``"offset"``, added.
    name : str
        Whose it is.
    chi2 : float
        Test statistic.
    dof : int
        Its degrees of freedom.
    log10_chance : float
        Logarithm to base 10 of the probability that chance alone makes it as large, all that were tried allowed for.
    shift_enu_m : tuple of float, or None
        By how much the position moves without the group or with the explanation, m; None where there is no position.
    shift_sigma_enu_m : tuple of float, or None
        How much it would move by chance, one standard deviation, m.
    amounts : dict of str to float
        What explains it, by component, in `unit`.
    unit : str
        Of the amounts.
    first_utc, last_utc : str
        From when to when; empty where all the time.
    """

    kind: str
    name: str
    chi2: float
    dof: int
    log10_chance: float
    shift_enu_m: tuple[float, float, float] | None
    shift_sigma_enu_m: tuple[float, float, float] | None
    amounts: dict[str, float]
    unit: str = ""
    first_utc: str = ""
    last_utc: str = ""

    @property
    def significant(self) -> bool:
        """Whether chance hardly explains it."""
        return self.log10_chance < math.log10(CHANCE)

    def to_dict(self) -> dict[str, Any]:
        """Its numbers, with the sentence as ``text`` where it is significant."""
        content: dict[str, Any] = {
            name: getattr(self, name) for name in ("kind", "name", "chi2", "dof", "log10_chance")
        }
        for key in ("shift", "shift_sigma"):
            values = getattr(self, f"{key}_enu_m") or (None, None, None)
            content[key] = dict(zip(("east_m", "north_m", "up_m"), values, strict=True))
        content |= {"amounts": self.amounts, "unit": self.unit}
        content |= {"first_utc": self.first_utc or None, "last_utc": self.last_utc or None}
        return content | {"significant": self.significant, "text": str(self) if self.significant else None}

    def __str__(self) -> str:
        when = f" from {self.first_utc} to {self.last_utc}" if self.last_utc else ""
        what = f"{self.name}{when} does not fit the others"
        value = next(iter(self.amounts.values()), 0.0)
        if self.kind == "jump":
            what = f"{self.name} jumps by {_length(value)} at {self.first_utc}"
        elif self.kind == "offset":
            what = f"{self.name} is off by {_length(value)}{when}"
        elif self.kind == "a priori":
            what = self._wrong_prior()
        if self.shift_enu_m is None:
            return what
        how = "with that" if self.amounts else "without it"
        return f"{what}; {how} the position moves by {math.hypot(*self.shift_enu_m):.3g} m"

    def _wrong_prior(self) -> str:
        kind, _, of = self.name.partition(".")
        parts = " ".join(
            f"{value:+.3g} {self.unit}{f' {name}' if name else ''}".replace("  ", " ")
            for name, value in self.amounts.items()
        )
        if kind == "position":
            return f"the a-priori {of} does not fit the observations ({parts} explains it)"
        words = "displacement" if kind == "station_position" else kind.replace("_", " ")
        article = "an" if words[0] in "aeio" else "a"
        return f"{of or kind} does not fit the others ({article} {words} of {parts} explains it)"


def _length(value_m: float) -> str:
    return f"{value_m:+.3g} m ({1e9 * value_m / C_M_S:+.3g} ns)"


@dataclass(frozen=True, slots=True)
class Consistency:
    """Whether the observations agree with each other and with the a-priori values.

    Parameters
    ----------
    groups : tuple of Inconsistency
        Stations, links, types and passes, each without the rest; those that fit too.
    found : tuple of Inconsistency
        What does not fit, the clearest first, each with those before it taken into account.
    """

    groups: tuple[Inconsistency, ...] = ()
    found: tuple[Inconsistency, ...] = ()

    def __repr__(self) -> str:
        return f"<Consistency of {len(self.groups)} groups, {len(self.found)} finding(s)>"

    def to_list(self) -> list[dict[str, Any]]:
        """What was found, then the groups, in types that JSON has."""
        return [item.to_dict() for item in (*self.found, *self.groups)]


@dataclass(frozen=True, slots=True, eq=False)
class _Tried:
    """A group or an explanation before it has a name in words."""

    kind: str
    name: str
    columns: _Floats
    verdict: Verdict
    components: tuple[str, ...] = ("",)  # none where a group is taken out
    scale: float | _Floats = 1.0
    unit: str = "m"
    span_s: tuple[float, float] | None = None
    links: Mapping[int, float] = field(default_factory=dict)
    width_s: float = 0.0  # of the bins that a step was found in
    log_chance: float = 0.0

    def explained(self, problem: BinnedProblem) -> tuple[_Tried, BinnedProblem, float]:
        """What explains a misfit, and the problem with it as parameters, in parts of a length: more is then known.

        It is one component where the others may be zero by chance.
        """
        length = float(np.linalg.norm(self.columns))
        after, count = problem.with_columns(self.columns / length), len(self.components)
        if count < 2:
            return self, after, length
        values, covariance = after.estimate[-count:], after.inverse[-count:, -count:]
        chances = []
        for k in range(count):
            others = np.delete(np.arange(count), k)
            chi2 = values[others] @ np.linalg.solve(covariance[np.ix_(others, others)], values[others])
            chances.append(log_probability(float(chi2), count - 1))
        k = int(np.argmax(chances))
        verdict = problem.test(self.columns[:, [k]])
        if chances[k] <= math.log(_SIMPLER) or verdict is None:
            return self, after, length
        part, scale = self.components[k : k + 1], np.asarray(self.scale)[[k]]
        return replace(
            self, columns=self.columns[:, [k]], components=part, scale=scale, verdict=verdict
        ).explained(problem)


def assess_consistency(
    edited: EditedFit,
    order: SeriesOrder,
    correlation: TimeCorrelation | None,
    epoch_utc: Epochs,
    enu_by_parameters: _Floats | None,
    considered: ConsideredErrors | None = None,
) -> Consistency:
    """Test groups of observations and a-priori values against the rest, and look for steps and offsets.

    Parameters
    ----------
    edited : EditedFit
        The fit; there is nothing to say of one that did not converge.
    order : SeriesOrder
        Types, paths and times of the observations.
    correlation : TimeCorrelation or None
        Noise of series that are correlated in time.
    epoch_utc : Epochs
        UTC of the observations.
    enu_by_parameters : ndarray, shape (3, p), or None
        d(position east, north, up)/d(parameter); None where there is no position.
    considered : ConsideredErrors or None
        What else may be wrong, and by how much.
    """
    fit = edited.fit
    if not edited.converged or fit.dof < 1 or not (fit.parameters.free.any() and fit.used.any()):
        return Consistency()
    fit = replace(fit, used=_readmitted(edited, order))
    search = _Search(fit, order, epoch_utc, enu_by_parameters, considered)
    problem = BinnedProblem.of(
        fit, order, {} if correlation is None else noise_of_each(fit, order), considered
    )
    tested = search.groups(problem)
    groups = tuple(search.named(tried, tried.verdict) for tried in tested)
    explained: list[tuple[_Tried, float]] = []
    width = len(problem.estimate)
    while len(explained) < _MOST_FOUND:
        best = min([*search.explanations(problem), *tested], key=lambda tried: tried.log_chance, default=None)
        if best is None or best.log_chance > math.log(CHANCE):
            break
        best, problem, length = best.explained(problem)
        verdict = replace(best.verdict, shift=problem.estimate[:width])
        explained.append((replace(best, verdict=verdict), length))
        if not best.components:
            break
        tested = search.groups(problem)
    found = []
    for tried, length in explained:
        end = width + tried.columns.shape[1]
        amounts = problem.estimate[width:end] / length
        found.append(search.named(tried, replace(tried.verdict, estimate=amounts)))
        width = end
    return Consistency(groups, tuple(found))


def _readmitted(edited: EditedFit, order: SeriesOrder) -> NDArray[np.bool_]:
    """Observations in use, and those of series of which the editing has left out most: these are no outliers."""
    usable, used = edited.given.are(USED), edited.fit.used
    count, kept = (np.bincount(order.code[of], minlength=order.code.max() + 1) for of in (usable, used))
    return np.asarray(used | (usable & (kept < _MOST_KEPT * count)[order.code]))


@dataclass(frozen=True, slots=True, eq=False)
class _Search:
    """What is tested in a problem."""

    fit: FitResult
    order: SeriesOrder
    epoch_utc: Epochs
    enu_by_parameters: _Floats | None
    considered: ConsideredErrors | None

    def links_by_name(self, problem: BinnedProblem) -> dict[tuple[str, str], dict[int, float]]:
        """Series of single observations of each link, type and station, with the sign of what is at a station."""
        codes = np.unique(problem.code).tolist()
        found = {("link", self.order.name_of(code)): {code: 1.0} for code in codes}
        for code in codes:
            found.setdefault(("type", self.order.type_of(code)), {})[code] = 1.0
        for code in codes:
            for station, sign in self.order.stations[code].items():
                found.setdefault(("station", station), {})[code] = sign
        return found

    def groups(self, problem: BinnedProblem) -> list[_Tried]:
        """The estimate without each group: stations and their passes, links, types."""
        every = self.links_by_name(problem)
        count = sum(kind == "link" for kind, _ in every)
        tested: list[tuple[str, str, tuple[float, float] | None, Mapping[int, float]]] = []
        for (kind, name), mine in every.items():
            spans = _passes(problem, mine) if kind == "station" else []
            if 1 < len(spans) < _MOST_GROUPS - len(tested):
                tested += [("pass", name, span_s, mine) for span_s in spans]
            if len(mine) < count:
                tested.append((kind, name, None, mine))
        width = self.fit.factor.root_covariance().shape[1]
        found = [_tried(problem, kind, name, links, span_s, width) for kind, name, span_s, links in tested]
        return _judged(found, len(tested))

    def explanations(self, problem: BinnedProblem) -> list[_Tried]:
        """A-priori values set free, steps and offsets."""
        return [*self._wrong_priors(problem), *self._steps(problem), *self._offsets(problem)]

    def _wrong_priors(self, problem: BinnedProblem) -> list[_Tried]:
        """A-priori values that are set free, each, and all components of one together."""
        known = [item for item in self.fit.parameters if not item.fixed and math.isfinite(item.prior_sigma)]
        known += [] if self.considered is None else self.considered.parameters.parameters
        sets: dict[str, list[int]] = {}
        for place, item in enumerate(known):
            sets[item.name] = [place]
            if item.kind != "position" and item.name.count(".") == 2:  # one of several components
                sets.setdefault(item.name.rpartition(".")[0], []).append(place)
        first, found = len(problem.points.time_s), []
        for places in sets.values():
            columns = np.zeros((len(problem.whitened), len(places)))
            columns[first + np.array(places), np.arange(len(places))] = 1.0
            if (verdict := problem.test(columns)) is None:
                continue
            items = [known[place] for place in places]
            kind, _, of = items[0].name.partition(".")
            whose, _, component = of.partition(".") if kind != "position" else (of, "", "")
            parts = tuple(item.name.rpartition(".")[2] if component else "" for item in items)
            # The residual is the a-priori value less the estimate
            sigmas, named = -np.array([item.prior_sigma for item in items]), f"{kind}.{whose}".rstrip(".")
            found.append(_Tried("a priori", named, columns, verdict, parts, sigmas, items[0].unit))
        return _judged(found, len(sets))

    def _sets(self, problem: BinnedProblem) -> Iterator[tuple[str, dict[int, float]]]:
        """Links, and stations with several links of one type, with signs."""
        for (kind, name), mine in self.links_by_name(problem).items():
            if kind == "link":
                yield name, mine
            elif kind == "station":
                for of in sorted({self.order.type_of(code) for code in mine}):
                    some = {
                        code: sign for code, sign in mine.items() if sign and self.order.type_of(code) == of
                    }
                    if len(some) > 1:
                        yield f"{name} {of}", some

    def _steps(self, problem: BinnedProblem) -> list[_Tried]:
        """The step that fits best of each set, all epochs allowed for."""
        found, total = [], 0
        for name, mine in self._sets(problem):
            edges_s = problem.times_s(mine)[_FEWEST : 1 - _FEWEST]
            total += len(edges_s)
            if len(edges_s):
                chi2, _ = problem.each(problem.columns(mine, (edges_s, np.inf)))
                span_s = float(edges_s[int(np.argmax(chi2))]), np.inf
                found.append(_tried(problem, "jump", name, mine, span_s))
        return _judged(found, total)

    def _offsets(self, problem: BinnedProblem) -> list[_Tried]:
        """Links that are off in one pass or throughout."""
        found = []
        for name, mine in self._sets(problem):
            passes = _passes(problem, mine)
            spans = (None, *(passes if len(passes) > 1 else ()))
            found += [_tried(problem, "offset", name, mine, span_s) for span_s in spans]
        return _judged(found, len(found))

    def named(self, tried: _Tried, verdict: Verdict) -> Inconsistency:
        """What was found, with its numbers."""
        shift = sigma = None
        if self.enu_by_parameters is not None:
            root = self.fit.factor.root_covariance()
            by_unit = self.enu_by_parameters[:, self.fit.parameters.free] @ root
            width = root.shape[1]
            shift = tuple((by_unit @ verdict.shift[:width]).tolist())
            sigma = tuple(np.linalg.norm(by_unit @ verdict.root_of_shift[:width], axis=1).tolist())
        amounts = verdict.estimate * tried.scale if tried.components else np.zeros(0)
        first, last = self._span(tried)
        return Inconsistency(
            tried.kind,
            tried.name,
            verdict.chi2,
            verdict.dof,
            min(tried.log_chance, 0.0) / math.log(10.0),
            shift,
            sigma,
            dict(zip(tried.components, amounts.tolist(), strict=True)),
            tried.unit if tried.components else "",
            first,
            last,
        )

    def _span(self, tried: _Tried) -> tuple[str, str]:
        """First and last epoch, of the observations that are in it."""
        if tried.span_s is None:
            return "", ""
        order, (begin_s, end_s) = self.order, tried.span_s
        rows = np.flatnonzero(self.fit.used & np.isin(order.code, list(tried.links)))
        rows = rows[np.argsort(order.time_s[rows], kind="stable")]
        time_s = order.time_s[rows]
        first = int(np.searchsorted(time_s, begin_s))
        if tried.width_s > 0.0:
            near = np.flatnonzero(np.abs(time_s - begin_s) <= 3.0 * tried.width_s)
            signs = np.array([tried.links[code] for code in order.code[rows[near]].tolist()])
            sums = np.cumsum(signs * self.fit.residual_m[rows[near]])
            before = np.arange(1, len(near))
            steps = (sums[:-1] - before * sums[-1] / len(near)) ** 2 / (before * (len(near) - before))
            first = int(near[1 + int(np.argmax(steps))])
        last = int(np.searchsorted(time_s, end_s, side="right")) - 1
        epochs = utc_strings(self.epoch_utc[rows[[first, last]]], decimals=0)
        return str(epochs[0]), "" if math.isinf(end_s) else str(epochs[1])


def _tried(
    problem: BinnedProblem,
    kind: str,
    name: str,
    links: Mapping[int, float],
    span_s: tuple[float, float] | None,
    parameters: int = 0,
) -> _Tried | None:
    """Links in a span of time with parameters of their own, or with a constant; none where nothing is told."""
    columns = problem.columns(links, span_s or (-np.inf, np.inf), parameters)
    if (verdict := problem.test(columns, links)) is None:
        return None
    components, width_s = () if parameters else ("",), problem.width_s(links) if kind == "jump" else 0.0
    return _Tried(kind, name, columns, verdict, components, span_s=span_s, links=links, width_s=width_s)


def _judged(tried: Iterable[_Tried | None], count: int) -> list[_Tried]:
    """With their chances, so many having been tried in each family."""
    every = math.log(_FAMILIES * max(count, 1))
    return [replace(one, log_chance=one.verdict.log_chance + every) for one in tried if one is not None]


def _passes(problem: BinnedProblem, links: Iterable[int]) -> list[tuple[float, float]]:
    """Begin and end of the passes of some links."""
    time_s = problem.times_s(links)
    gaps = np.flatnonzero(np.diff(time_s) > 3600.0 * PASS_GAP_H)
    begin, end = np.append(0, gaps + 1), np.append(gaps, len(time_s) - 1)
    return list(zip(time_s[begin].tolist(), time_s[end].tolist(), strict=True))
