"""What the error of a position is made of: independent sources, whose squares add up to the square of its total sigma.

The estimate from observations with the noise e and a-priori values with the errors d is off by C A^T W e + C P d, with
the covariance C = (A^T W A + P)^-1 of the weights W and the information P of the a-priori values; to that come the
effects of considered parameters (:mod:`~radioloc.estimation.consider`) and the error assumed of the ephemeris.
Tapley, Schutz and Born (2004), section 6.2.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radioloc.estimation.consider import Consider
from radioloc.estimation.least_squares import FitResult
from radioloc.parameters.parameter import Parameter, ParameterSet
from radioloc.parameters.registry import PARAMETERS

NOISE, A_PRIORI, EPHEMERIS = "measurement noise", "a priori", "ephemeris"


@dataclass(frozen=True, slots=True)
class BudgetItem:
    """The sigma of a position by one source.

    Parameters
    ----------
    source : str
        Measurement noise, with what is correlated in time; a-priori values of what is estimated; a kind of considered
        parameter; the error assumed of the ephemeris.
    name : str
        Of a-priori values the parameter, of a kind whose it is: a station, a link; else empty.
    east_m, north_m, up_m, total_m : float
        Standard deviations, and the root of their squares' sum.
    """

    source: str
    name: str
    east_m: float
    north_m: float
    up_m: float
    total_m: float

    @classmethod
    def of(cls, source: str, name: str, variances_m2: NDArray[np.float64]) -> BudgetItem:
        """Of variances to the east, to the north and up, m^2."""
        sides = np.sqrt(np.maximum(variances_m2, 0.0))
        east_m, north_m, up_m = sides.tolist()
        return cls(source, name, east_m, north_m, up_m, float(np.linalg.norm(sides)))

    def to_dict(self) -> dict[str, Any]:
        """Its fields."""
        return asdict(self)


def prior_effects(fit: FitResult) -> NDArray[np.float64]:
    """Change of the estimate by an error of one sigma of each a-priori value (columns), shape (p, p)."""
    free = np.flatnonzero(fit.parameters.free)
    root = fit.factor.root_covariance()
    effects = np.zeros((len(fit.parameters),) * 2)
    effects[np.ix_(free, free)] = root @ root.T / fit.parameters.prior_sigmas[free]
    return effects


def sources(
    parameters: ParameterSet,
    enu_by_parameters: NDArray[np.float64],
    enu_covariance_m2: NDArray[np.float64],
    effects: NDArray[np.float64],
    considered: Consider | None,
    ephemeris_sigma_enu_m: NDArray[np.float64],
    direct_m: NDArray[np.float64] | float = 0.0,
) -> dict[tuple[str, str], NDArray[np.float64]]:
    """Covariance of the position by each source that there may be and its name, m^2, shape (..., 3, 3).

    Parameters
    ----------
    parameters : ParameterSet
        What was solved for, p.
    enu_by_parameters : ndarray, shape (..., 3, p)
        Partials of the position; of an orbit along, across and radial, at any epochs.
    enu_covariance_m2 : ndarray, shape (..., 3, 3)
        Its covariance by noise and a-priori values.
    effects : ndarray, shape (p, p)
        Of :func:`prior_effects`.
    considered : Consider or None
        Of c parameters.
    ephemeris_sigma_enu_m : ndarray, shape (3,)
    direct_m : ndarray, shape (..., 3, c), optional
        What errors of the considered parameters, one sigma each, add to the position's error by themselves.
    """

    def squared(moved_m: NDArray[np.float64], k: int) -> NDArray[np.float64]:
        return np.asarray(moved_m[..., :, None, k] * moved_m[..., None, :, k])

    of_priors_m = enu_by_parameters @ effects
    found = {(NOISE, ""): enu_covariance_m2 - of_priors_m @ np.swapaxes(of_priors_m, -1, -2)}
    for k, item in enumerate(parameters):
        found[A_PRIORI, item.name] = squared(of_priors_m, k)
    if considered is not None:
        of_errors_m = enu_by_parameters @ considered.sensitivity + direct_m
        for k, item in enumerate(considered.parameters):
            key = item.kind, owner(item)
            found[key] = found.get(key, 0.0) + squared(of_errors_m, k)
    found[EPHEMERIS, ""] = np.diag(ephemeris_sigma_enu_m**2)
    return found


def error_budget(found: Mapping[tuple[str, str], NDArray[np.float64]]) -> tuple[BudgetItem, ...]:
    """Sigmas by those of the :func:`sources` that have any, the largest first."""
    items = (BudgetItem.of(*key, np.diag(covariance_m2)) for key, covariance_m2 in found.items())
    return tuple(sorted((item for item in items if item.total_m > 0.0), key=lambda item: -item.total_m))


def owner(item: Parameter) -> str:
    """Whose a parameter is: its name without kind, component and number of the pass; nobody's of a drawn error."""
    if item.kind not in PARAMETERS:
        return ""
    _, _, name = item.name.partition(".")
    for component in PARAMETERS[item.kind].components:
        name = name.removesuffix(component).removesuffix(".") if component else name
    return name.rpartition(" ")[0] if item.span_utc is not None else name


def by_source(items: Iterable[BudgetItem]) -> list[BudgetItem]:
    """Each source as a whole, the largest first."""
    groups: dict[str, list[BudgetItem]] = {}
    for item in items:
        groups.setdefault(item.source, []).append(item)
    wholes = []
    for source, parts in groups.items():
        squares = np.array([(p.east_m**2, p.north_m**2, p.up_m**2) for p in parts]).sum(axis=0)
        wholes.append(BudgetItem.of(source, "", squares))
    return sorted(wholes, key=lambda whole: -whole.total_m)
