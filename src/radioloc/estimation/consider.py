"""Considered parameters: held at their a-priori values, whose errors are carried into the covariance of the estimate.

With the design matrix A of the estimated and B of the considered parameters, the weights W and the formal covariance
P, an error d of the considered parameters changes the estimate by S d, S = P A^T W B (Tapley, Schutz and Born 2004,
section 6.2; Montenbruck and Gill 2000, section 8.1.4). To the covariance comes S C S^T with their a-priori covariance
C.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radioloc.estimation.factorization import gram
from radioloc.estimation.least_squares import FitResult
from radioloc.estimation.linearization import Rows
from radioloc.estimation.observation_noise import Whitening
from radioloc.parameters.parameter import ParameterSet

Effects = Callable[[Rows], NDArray[np.float64]]
"""What independent errors of unit variance do to observations, m, from their indices (m,), shape (m, c)."""

_OF_FRAMES = frozenset(
    {
        *("station_position", "ut1", "pole", "moon_position", "moon_position_variation"),
        *("libration", "libration_variation", "love_numbers", "lunar_lengths", "gravity_error"),
    }
)
"""Kinds of parameter that weights do not allow for. An estimate that did would rest on how they change over the arc,
which is what their a-priori values, the same for a month or a year, say least about."""
_NEGLIGIBLE = 0.1
"""Length of errors, in the sigmas of the observations, that move no combination of parameters by more of its sigmas."""


@dataclass(frozen=True, slots=True, eq=False)
class ConsideredErrors:
    """Considered parameters, each with its sigma, and their columns of the design matrix.

    The partials are those of some observations, from their indices (m,) to d(computed)/d(parameter), shape (m, c).
    Those by what is at stations alone may be given as well, where they are had with less effort.
    """

    parameters: ParameterSet
    partials: Callable[[Rows], NDArray[np.float64]]
    station_partials: Callable[[Rows], NDArray[np.float64]] | None = None

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

    With their effects E and columns Y, both whitened by the noise, Y^T (1 + E E^T)^-1 Y is the square of Y - E g and,
    below, of the estimates of the errors g = (1 + E^T E)^-1 E^T Y (Woodbury 1950).
    """

    noise: Whitening
    effects: tuple[NDArray[np.float64], ...]  # E, part by part
    variance: NDArray[np.float64]  # (r,), diagonal of (1 + E^T E)^-1

    @classmethod
    def of(cls, noise: Whitening, effects_m: Effects) -> CommonErrors:
        """Effects on rows (m,), m, shape (m, c), of which those are kept that the noise does not hide."""
        whitened = list(noise.whitened(effects_m))
        squares, axes = np.linalg.eigh(sum(gram(part, part) for part in whitened))
        felt = squares > _NEGLIGIBLE**2
        effects = tuple(part @ axes[:, felt] for part in whitened)
        return cls(noise, effects, 1.0 / (1.0 + squares[felt]))

    def whitened(self, rows_of: Callable[[Rows], NDArray[np.float64]]) -> Iterator[NDArray[np.float64]]:
        """Independent combinations part by part, and the estimates of the errors as the last part."""
        parts, estimates = self.weighted(rows_of)
        yield from parts
        yield estimates

    def weighted(
        self, rows_of: Callable[[Rows], NDArray[np.float64]]
    ) -> tuple[list[NDArray[np.float64]], NDArray[np.float64]]:
        """Columns whitened by the noise times (1 + E E^T)^-1, part by part, and the estimates of the errors in them."""
        parts = list(self.noise.whitened(rows_of))
        along = sum(gram(effect, part) for effect, part in zip(self.effects, parts, strict=True))
        estimates = self.variance[:, None] * along
        for effect, part in zip(self.effects, parts, strict=True):
            part -= effect @ estimates
        return parts, estimates


@dataclass(frozen=True, slots=True, eq=False)
class Consider:
    """What considered parameters do to an estimate.

    The sensitivity is the change of the estimate (rows) by an error of one sigma of each considered parameter
    (columns).
    """

    parameters: ParameterSet  # the considered ones, c
    sensitivity: NDArray[np.float64]  # (p, c)

    def __repr__(self) -> str:
        kinds = ", ".join(dict.fromkeys(item.kind for item in self.parameters))
        return f"<Consider {len(self.parameters)} parameters: {kinds}>"

    @property
    def covariance(self) -> NDArray[np.float64]:
        """What they add to the covariance of the estimate, shape (p, p)."""
        return np.asarray(self.sensitivity @ self.sensitivity.T)

    def to_list(self, enu_by_parameters: NDArray[np.float64] | None) -> list[dict[str, Any]]:
        """One record for each, the one that moves the position most first; no displacements without partials (3, p)."""
        records: list[dict[str, Any]] = []
        for k, item in enumerate(self.parameters):
            records.append({"name": item.name, "unit": item.unit, "sigma": item.prior_sigma})
            if enu_by_parameters is not None:
                records[-1]["position_enu_m"] = (enu_by_parameters @ self.sensitivity[:, k]).tolist()
        return sorted(records, key=lambda record: -float(np.linalg.norm(record.get("position_enu_m", 0.0))))


def consider(fit: FitResult, errors: ConsideredErrors) -> Consider:
    """What considered parameters do to the estimate of a fit."""
    moved = moved_by(fit, errors.partials, len(errors.parameters))
    return Consider(errors.parameters, moved * errors.parameters.prior_sigmas)


def moved_by(
    fit: FitResult, effects_m: Callable[[Rows], NDArray[np.float64]], count: int
) -> NDArray[np.float64]:
    """By how much errors move the estimate, shape (p, count), from their effects on observations (m,), (m, count).

    Directions that the data do not determine have no part in it: their variance is infinite already.
    """
    root, partials = fit.factor.root_covariance(), fit.unit_partials()
    along, q = np.zeros((root.shape[1], count)), root.shape[1]
    if isinstance(fit.whitening, CommonErrors):
        weighted, _ = fit.whitening.weighted(partials)
        for one, effects in zip(weighted, fit.whitening.noise.whitened(effects_m), strict=True):
            along += gram(one, effects)
    else:
        for part in fit.whitening.whitened(lambda rows: np.hstack([partials(rows), effects_m(rows)])):
            along += gram(part[:, :q], part[:, q:])
    moved = np.zeros((len(fit.parameters), count))
    moved[fit.parameters.free] = root @ along
    return moved


def few_errors(errors: ConsideredErrors, sigma_m: NDArray[np.float64]) -> tuple[NDArray[np.float64], int]:
    """Effects (n, r), m, of some independent errors that stand for all, and how many of them, the first, at stations.

    What is left out of a variance is below 1 % of that which observations of `sigma_m` (n,) would leave.
    """
    mine, found = errors._at_stations, []
    effects = errors.partials(np.arange(len(sigma_m))) * errors.parameters.prior_sigmas
    for some in (effects[:, mine], np.delete(effects, mine, axis=1)):
        weighted = some / sigma_m[:, None]
        squares, axes = np.linalg.eigh(gram(weighted, weighted))
        found.append(some @ axes[:, np.cumsum(squares) > _NEGLIGIBLE**2])
    return np.hstack(found), found[0].shape[1]
