"""Considered parameters, and what the error of a position is made of.

Considered parameters are held at their a-priori values, whose errors are carried into the covariance of the estimate.
With the design matrix A of the estimated and B of the considered parameters, the weights W and the formal covariance
P, an error d of the considered parameters changes the estimate by S d, S = P A^T W B (Tapley, Schutz and Born 2004,
section 6.2; Montenbruck and Gill 2000, section 8.1.4). To the covariance comes S C S^T with their a-priori covariance
C.

The error budget is of independent sources, whose squares add up to the square of the position's total sigma: from
observations with the noise e and a-priori values with the errors d the estimate is off by P A^T W e + P Q d, with the
information Q of the a-priori values; to that come the effects of considered parameters and the error assumed of the
ephemeris.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radioloc.estimation.least_squares import FitResult
from radioloc.estimation.linearization import gram, times
from radioloc.estimation.observation_noise import RowsOf, Transposable, Whitening, slices
from radioloc.estimation.orbit_state import EAST_NORTH_UP
from radioloc.parameters.parameter import Parameter, ParameterSet
from radioloc.parameters.registry import PARAMETERS
from radioloc.vectors import Floats

NOISE, A_PRIORI, EPHEMERIS = "measurement noise", "a priori", "ephemeris"
"""Sources of error that are no considered parameters."""

Effects = RowsOf
"""What independent errors of unit variance do to observations, m, from their indices (m,), shape (m, c)."""

_OF_FRAMES = frozenset(
    {
        *("station_position", "ut1", "pole", "moon_position", "moon_position_variation"),
        *("libration", "libration_variation", "love_numbers", "lunar_lengths", "gravity_error"),
    }
)
"""Kinds of parameter that weights do not allow for. An estimate that did would rest on how they change over the arc,
which is what their a-priori values, the same for a month or a year, say least about."""
_MIN_EFFECT_SIGMAS = 0.1  # length of errors that move no combination of parameters by more of its sigmas
_MIN_WEIGHT_EFFECT_SIGMAS = 0.01  # its square is the relative change of a variance: 0.1 would be 1 %
_MIN_INFORMATION_RATIO = 1e-10  # least determined eigenvalue over the largest: rounding is below
_EFFECT_COLUMN_COUNT = 16  # of more effects fewer rows are held together


@dataclass(frozen=True, slots=True, eq=False)
class ConsideredErrors:
    """Considered parameters with their sigmas, and their columns of the design matrix by rows, (m, c)."""

    parameters: ParameterSet
    partials: RowsOf
    station_partials: RowsOf | None = None  # by what is at stations alone, where that is less effort

    @property
    def at_stations(self) -> Effects | None:
        """Effects of what is at stations, in the air above them and in maps, which a fit tells from the position."""
        mine = self._at_stations
        sigmas = self.parameters.prior_sigmas[mine]
        partials = self.station_partials or (lambda rows: self.partials(rows)[:, mine])
        return (lambda rows: partials(rows) * sigmas) if len(mine) else None

    @property
    def _at_stations(self) -> NDArray[np.intp]:
        return np.flatnonzero([is_at_station(item.kind) for item in self.parameters])


def is_at_station(kind: str) -> bool:
    """Whether a kind of parameter is of stations or the air above them, not of frames that all observations share."""
    return kind not in _OF_FRAMES


@dataclass(frozen=True, slots=True, eq=False)
class CommonErrors:
    """Noise with further errors, independent and of unit variance, that many observations share.

    Without it the sigma of `examples/change5/change5.toml`, clocks considered, is 12.7 m in place of 10.5 m.
    """

    # With effects E and columns Y whitened by the noise, Y^T (1 + E E^T)^-1 Y is the square of Y - E g and, below, of
    # the estimates of the errors g = (1 + E^T E)^-1 E^T Y (Woodbury 1950).
    noise: Whitening
    # Part by part, which columns are not zero, and these
    effects: tuple[tuple[NDArray[np.intp], Floats], ...]
    axes: Floats  # (c, r), combinations of the columns that are E
    variance: Floats  # (r,), diagonal of (1 + E^T E)^-1

    @classmethod
    def of(cls, noise: Whitening, effects_m: Effects) -> CommonErrors:
        """Effects on rows (m,), m, shape (m, c), of which those are kept that the noise does not hide."""
        effects, products = list[tuple[NDArray[np.intp], Floats]](), np.zeros((0, 0))
        for part in noise.whitened(effects_m):
            # Of errors of all stations and passes few have part in any observation
            there = np.flatnonzero(part.any(axis=0))
            some = part[:, there]
            products = products if effects else np.zeros((part.shape[1],) * 2)
            products[np.ix_(there, there)] += gram(some, some)
            effects.append((there, some))
        squares, axes = np.linalg.eigh(products)
        felt = squares > _MIN_WEIGHT_EFFECT_SIGMAS**2
        return cls(noise, tuple(effects), axes[:, felt], 1.0 / (1.0 + squares[felt]))

    def whitened(self, rows_of: RowsOf) -> Iterator[Floats]:
        """Independent combinations part by part, and the estimates of the errors as the last part."""
        parts = list(self.noise.whitened(rows_of))
        along = np.zeros((len(self.axes), parts[0].shape[1]))
        for (there, some), part in zip(self.effects, parts, strict=True):
            along[there] += gram(some, part)
        estimates = self.variance[:, None] * (self.axes.T @ along)
        taken = self.axes @ estimates
        for (there, some), part in zip(self.effects, parts, strict=True):
            part -= times(some, taken[there])
            yield part
        yield estimates


@dataclass(frozen=True, slots=True, eq=False)
class Consider:
    """Considered parameters, and the change of an estimate (rows) by one sigma of each (columns)."""

    parameters: ParameterSet  # the considered ones, c
    sensitivity: Floats  # (p, c)
    in_weights: tuple[str, ...] = ()  # kinds of them that the weights of the estimate allow for

    def __repr__(self) -> str:
        kinds = ", ".join(dict.fromkeys(item.kind for item in self.parameters))
        return f"<Consider {len(self.parameters)} parameters: {kinds}>"

    @property
    def covariance(self) -> Floats:
        """What they add to the covariance of the estimate, shape (p, p)."""
        return np.asarray(self.sensitivity @ self.sensitivity.T)

    def to_list(self, enu_by_parameters: Floats | None) -> list[dict[str, Any]]:
        """One record for each, the one that moves the position most first; no displacements without partials (3, p)."""
        records: list[dict[str, Any]] = []
        for k, item in enumerate(self.parameters):
            records.append(
                {"name": item.name, "unit": item.unit, "sigma": item.prior_sigma} | span_record(item)
            )
            if enu_by_parameters is not None:
                records[-1]["position_enu_m"] = (enu_by_parameters @ self.sensitivity[:, k]).tolist()
        return sorted(records, key=lambda record: -float(np.linalg.norm(record.get("position_enu_m", 0.0))))


def span_record(item: Parameter) -> dict[str, str]:
    """When a parameter of a pass or another time begins and ends, which tells it from those of other arcs."""
    return {} if item.span_utc is None else dict(zip(("first_utc", "last_utc"), item.span_utc, strict=True))


def consider(fit: FitResult, errors: ConsideredErrors) -> Consider:
    """What considered parameters do to the estimate of a fit."""
    moved = moved_by(fit, errors.partials, len(errors.parameters))
    kinds = dict.fromkeys(item.kind for item in errors.parameters if is_at_station(item.kind))
    allowed_for = tuple(kinds) if isinstance(fit.whitening, CommonErrors) else ()
    return Consider(errors.parameters, moved * errors.parameters.prior_sigmas, allowed_for)


def effects_beside_prior(fit: FitResult, errors: ConsideredErrors) -> Effects:
    """Effects for weights of tracking that is combined with an independent a-priori position.

    Without it the fit with a position from a map is not the joint estimate of both
    (`tests/unit/study/test_map_positions.py`).
    """
    # Beside the errors at stations these are those of frames, as far as they move the position: with the sensitivity
    # S of a position from the tracking alone, A S. The a-priori position then counts against the total covariance of
    # that, N^-1 + S S^T, as where two results are combined. Other parameters have no part in it: their a-priori
    # values do not share the error.
    parameters, root, free = fit.parameters, fit.factor.root_covariance(), fit.parameters.free
    frames = np.flatnonzero([not is_at_station(item.kind) for item in errors.parameters])
    # In parameters of unit covariance, which differ in units.
    sigmas = np.linalg.norm(root, axis=1)
    sigmas[sigmas == 0.0] = 1.0
    unit = root / sigmas[:, None]
    information = np.linalg.pinv(unit @ unit.T, rcond=_MIN_INFORMATION_RATIO, hermitian=True)
    placed = np.array([item.kind == "position" for item in parameters])[free]
    tracking = information - np.diag(placed * (sigmas / parameters.prior_sigmas[free]) ** 2)
    alone = np.linalg.pinv(tracking, rcond=_MIN_INFORMATION_RATIO, hermitian=True)
    moved = moved_by(fit, errors.partials, len(errors.parameters)) * errors.parameters.prior_sigmas
    sensitivity = np.zeros((len(parameters), len(frames)))
    sensitivity[free] = (placed * sigmas)[:, None] * (
        alone @ information @ (moved[np.ix_(free, frames)] / sigmas[:, None])
    )
    of_stations = errors.at_stations

    def effects(rows: NDArray[np.intp]) -> Floats:
        of_frames = fit.linearization.partials(rows) @ sensitivity
        return of_frames if of_stations is None else np.hstack([of_stations(rows), of_frames])

    return effects


def moved_by(fit: FitResult, effects_m: RowsOf, count: int) -> Floats:
    """Sensitivity of the estimate, (p, count), to errors by their effects on observations (m,), (m, count)."""
    # Directions that the data do not determine have no part in it: their variance is infinite already.
    root, moved = fit.factor.root_covariance(), np.zeros((len(fit.parameters), count))
    if not count:
        return moved
    along = np.zeros((root.shape[1], count))
    # Of common errors effects are weighed by the noise alone; estimates of the errors come last
    alone = fit.whitening.noise if isinstance(fit.whitening, CommonErrors) else fit.whitening
    whitened = fit.whitened_unit_partials()
    if isinstance(alone, Transposable):
        # Weights of few parameters are brought to the observations, not many effects to independent combinations
        for rows, weights in alone.transposed(whitened):
            for some in slices(len(rows), 1 + count // _EFFECT_COLUMN_COUNT):
                along += gram(weights[some], effects_m(rows[some]))
    else:
        for partials, effects in zip(whitened, alone.whitened(effects_m), strict=False):
            along += gram(partials, effects)
    moved[fit.parameters.free] = root @ along
    return moved


def few_errors(errors: ConsideredErrors, sigma_m: Floats) -> tuple[Floats, int]:
    """Effects (n, r), m, of few independent errors in place of all, and the count of those, the first, at stations."""
    # What is left out of a variance is below 1 % of that which observations of `sigma_m` (n,) would leave.
    mine, found = errors._at_stations, []
    effects = errors.partials(np.arange(len(sigma_m))) * errors.parameters.prior_sigmas
    for some in (effects[:, mine], np.delete(effects, mine, axis=1)):
        weighted = some / sigma_m[:, None]
        squares, axes = np.linalg.eigh(gram(weighted, weighted))
        found.append(times(some, axes[:, np.cumsum(squares) > _MIN_EFFECT_SIGMAS**2]))
    return np.hstack(found), found[0].shape[1]


@dataclass(frozen=True, slots=True, eq=False)
class ErrorSource:
    """Part of the covariance of a position, m^2, (3, 3); `name` is the parameter or its owner, or empty."""

    source: str
    name: str
    covariance_m2: Floats

    @property
    def label(self) -> str:
        """Source and name in one text."""
        return f"{self.source} {self.name}".strip()

    @property
    def sigma_m(self) -> Floats:
        """Standard deviations along the axes, shape (3,)."""
        return np.sqrt(np.maximum(np.diag(self.covariance_m2), 0.0))

    @property
    def total_m(self) -> float:
        """Standard deviation in space."""
        return float(np.linalg.norm(self.sigma_m))

    def to_dict(self, axes: Iterable[str] = EAST_NORTH_UP) -> dict[str, Any]:
        """Source, name and standard deviations, in types that JSON has."""
        sigmas_m = zip((*axes, "total"), (*self.sigma_m.tolist(), self.total_m), strict=True)
        return {"source": self.source, "name": self.name} | {f"{axis}_m": sigma for axis, sigma in sigmas_m}


def prior_effects(fit: FitResult) -> Floats:
    """Change of the estimate by an error of one sigma of each a-priori value (columns), shape (p, p)."""
    free = np.flatnonzero(fit.parameters.free)
    root = fit.factor.root_covariance()
    effects = np.zeros((len(fit.parameters),) * 2)
    effects[np.ix_(free, free)] = root @ root.T / fit.parameters.prior_sigmas[free]
    return effects


def shared_prior_effects(parameters: ParameterSet, effects: Floats) -> dict[str, Floats]:
    """Change of the estimate (p,) by one sigma of each error that a-priori values share, by its name."""
    names = dict.fromkeys(name for item in parameters for name in item.prior_errors)
    return {
        name: effects
        @ (np.array([item.prior_errors.get(name, 0.0) for item in parameters]) / parameters.prior_sigmas)
        for name in names
    }


def error_budget(
    parameters: ParameterSet,
    enu_by_parameters: Floats,
    enu_covariance_m2: Floats,
    effects: Floats,
    considered: Consider | None,
    ephemeris_sigma_enu_m: Floats,
    direct_m: Floats | float = 0.0,
) -> tuple[ErrorSource, ...]:
    """Divide the covariance of a position into independent sources, the largest first."""

    # Partials (..., 3, p) and the covariance by noise and a-priori values (..., 3, 3) may be at any epochs of an orbit;
    # `effects` are those of prior_effects; errors of one sigma of considered parameters add `direct_m` (..., 3, c) by
    # themselves. Of several epochs the mean is given.
    def squared(moved_m: Floats, k: int) -> Floats:
        return np.asarray(moved_m[..., :, None, k] * moved_m[..., None, :, k])

    of_priors_m = enu_by_parameters @ effects
    found = {(NOISE, ""): enu_covariance_m2 - of_priors_m @ np.swapaxes(of_priors_m, -1, -2)}
    shared = shared_prior_effects(parameters, effects)
    rest: dict[str, tuple[str, str]] = {}
    for k, item in enumerate(parameters):
        # A-priori values that share errors are one source, less these errors.
        key = A_PRIORI, item.name.partition(".")[0] if item.prior_errors else item.name
        found[key] = found.get(key, 0.0) + squared(of_priors_m, k)
        rest |= dict.fromkeys(item.prior_errors, key)
    for name, moved in shared.items():
        kind, _, whose = name.partition(".")
        of_error_m2 = squared((enu_by_parameters @ moved)[..., None], 0)
        found[rest[name]] = found[rest[name]] - of_error_m2
        key = kind, whose.rpartition(".")[0] or whose
        found[key] = found.get(key, 0.0) + of_error_m2
    if considered is not None:
        of_errors_m = enu_by_parameters @ considered.sensitivity + direct_m
        for k, item in enumerate(considered.parameters):
            key = item.kind, owner(item)
            found[key] = found.get(key, 0.0) + squared(of_errors_m, k)
    found[EPHEMERIS, ""] = np.diag(ephemeris_sigma_enu_m**2)
    items = (ErrorSource(*key, part.reshape(-1, 3, 3).mean(axis=0)) for key, part in found.items())
    kept = (item for item in items if item.source not in (A_PRIORI, EPHEMERIS) or item.covariance_m2.any())
    return tuple(sorted(kept, key=lambda item: -item.total_m))


def owner(item: Parameter) -> str:
    """Whose a parameter is: its name without kind, component and number of the pass; nobody's of a drawn error."""
    if item.kind not in PARAMETERS:
        return ""
    _, _, name = item.name.partition(".")
    for component in PARAMETERS[item.kind].components:
        name = name.removesuffix(component).removesuffix(".") if component else name
    return name.rpartition(" ")[0] if item.span_utc is not None else name


def by_source(items: Iterable[ErrorSource]) -> list[ErrorSource]:
    """Each source as a whole, the largest first."""
    groups: dict[str, list[Floats]] = {}
    for item in items:
        groups.setdefault(item.source, []).append(item.covariance_m2)
    wholes = (ErrorSource(source, "", np.sum(parts, axis=0)) for source, parts in groups.items())
    return sorted(wholes, key=lambda whole: -whole.total_m)
