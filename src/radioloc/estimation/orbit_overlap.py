"""Arcs of an orbit that was determined, and by how much neighbours differ where they meet."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from radioloc.dynamics.elements import rtn_axes
from radioloc.estimation.orbit_state import OrbitState, by_axis
from radioloc.estimation.statistics import finite_or_none
from radioloc.time import Epochs, utc_strings

if TYPE_CHECKING:
    from radioloc.dynamics import AdjustableOrbit
    from radioloc.dynamics.arcs import OrbitArcs
    from radioloc.dynamics.disturbed import DisturbedOrbit

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class OrbitOverlap:
    """Two neighbouring arcs at the epoch where they meet: the later less the earlier, radial, along and across.

    Parameters
    ----------
    epoch : Epochs
        TDB, one.
    difference_m : ndarray, shape (3,)
    covariance_m2 : ndarray, shape (3, 3)
        What is expected of it, errors in common taken off; infinite where an arc is not determined.
    """

    epoch: Epochs
    difference_m: Floats
    covariance_m2: Floats

    @property
    def sigma_m(self) -> Floats:
        """Standard deviations that are expected of the difference, m, shape (3,)."""
        return np.sqrt(np.diag(self.covariance_m2))

    @property
    def sigmas(self) -> float | None:
        """Length of the difference in its sigmas; of three components by chance below 2.80 in 95 %."""
        if not np.isfinite(self.covariance_m2).all():
            return None
        return finite_or_none(
            float(np.sqrt(self.difference_m @ np.linalg.lstsq(self.covariance_m2, self.difference_m)[0]))
        )

    def to_dict(self) -> dict[str, Any]:
        """In types that JSON has."""
        return {
            "epoch_tdb": str(utc_strings(self.epoch, 3)[0]),
            "difference_m": by_axis(self.difference_m),
            "sigma_m": by_axis(self.sigma_m),
            "sigmas": self.sigmas,
        }


def states_of_arcs(
    arcs: OrbitArcs[AdjustableOrbit],
    covariance: Floats,
    disturbed: OrbitArcs[DisturbedOrbit] | None,
    sensitivity: Floats,
    body: int,
) -> tuple[OrbitState, ...]:
    """The states of arcs that were fitted; covariance and sensitivity are of all their parameters, Cartesian."""
    states = []
    for k, (arc, mine) in enumerate(zip(arcs.arcs, arcs.columns, strict=True)):
        errors = None if disturbed is None else disturbed.arcs[k]
        of_arc = sensitivity[mine] if len(sensitivity) else sensitivity
        states.append(OrbitState(arc, covariance[np.ix_(mine, mine)], errors, of_arc, body))
    return tuple(states)


def overlaps(
    arcs: OrbitArcs[AdjustableOrbit],
    covariance: Floats,
    disturbed: OrbitArcs[DisturbedOrbit] | None,
    sensitivity: Floats,
) -> tuple[OrbitOverlap, ...]:
    """Differences of neighbours; parameters as of :func:`states_of_arcs`."""
    found = []
    for k in range(len(arcs.borders)):
        epoch = arcs.borders[[k]]
        pair, columns = arcs.arcs[k : k + 2], arcs.columns[k : k + 2]
        (before_m, velocity_m_s), (after_m, _) = (arc.states(epoch) for arc in pair)
        axes = rtn_axes(before_m[0], velocity_m_s[0])
        by = np.zeros((3, len(covariance)))
        for sign, arc, mine in zip((-1.0, 1.0), pair, columns, strict=True):
            by[:, mine] += sign * (axes @ arc.position_partials(epoch)[0])
        own = covariance
        expected = np.zeros((3, 3))
        if disturbed is not None and len(sensitivity):
            own = covariance - sensitivity @ sensitivity.T
            first, second = (one.position_partials(epoch)[0] for one in disturbed.arcs[k : k + 2])
            moved = by @ sensitivity + axes @ (second - first)
            expected = moved @ moved.T
        expected = expected + by @ own @ by.T if np.isfinite(covariance).all() else np.full((3, 3), np.inf)
        found.append(OrbitOverlap(epoch, axes @ (after_m - before_m)[0], expected))
    return tuple(found)
