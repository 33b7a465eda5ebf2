"""Orbits of one spacecraft, one after the other in time, with parameters of their own and in common."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from radioloc.boundary import bare_arguments
from radioloc.dynamics.adjustable import AdjustableOrbit
from radioloc.dynamics.forces import Forces
from radioloc.dynamics.orbit import STATE
from radioloc.ephemeris import Ephemeris
from radioloc.time import Epochs

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class OrbitArcs:
    """Arcs of an orbit, each from its border with the one before to that with the next.

    An :class:`~radioloc.ephemeris.trajectory.AdjustableTrajectory`, whose parameters are those of all arcs.

    Parameters
    ----------
    arcs : tuple of AdjustableOrbit
        In the order of time, with spans that meet.
    borders : Epochs
        Where one ends and the next begins, TDB, one less than arcs.
    columns : tuple of ndarray
        For each arc which of the parameters its own are, in its order.
    names : tuple of str
        Of the parameters: those of the forces as they call them, with the arc's number behind those of one arc.
    forces : Forces
        A priori, with the impulses of all arcs.
    start : ndarray, shape (p,)
        By how much the parameters are larger where a fit should begin.
    """

    arcs: tuple[AdjustableOrbit, ...]
    borders: Epochs
    columns: tuple[NDArray[np.intp], ...]
    names: tuple[str, ...]
    forces: Forces
    start: Floats

    def __str__(self) -> str:
        return f"{len(self.arcs)} arcs of {self.name}"

    @property
    def name(self) -> str:
        """That of the spacecraft."""
        return self.arcs[0].name

    @property
    def notes(self) -> tuple[str, ...]:
        """How the first state was found."""
        return self.arcs[0].notes

    def _of_each(self, of_arc: Callable[[int, Epochs], Floats], tdb: Epochs) -> Floats:
        """What a function of an arc's index gives at epochs in that arc, shape (n, ...)."""
        borders_s = self.borders.seconds_since(self.borders[:1])
        which = np.searchsorted(borders_s, tdb.seconds_since(self.borders[:1]))
        present = np.unique(which) if len(tdb) else np.zeros(1, dtype=np.intp)
        rows = [np.flatnonzero(which == k) for k in present]
        found = [of_arc(k, tdb[mine]) for k, mine in zip(present, rows, strict=True)]
        return np.concatenate(found)[np.argsort(np.concatenate(rows))]

    @bare_arguments
    def geocentric(self, ephemeris: Ephemeris, tdb: Epochs) -> tuple[Floats, Floats]:
        """As :meth:`~radioloc.dynamics.orbit.Orbit.geocentric`."""
        found = self._of_each(lambda k, at: np.hstack(self.arcs[k].geocentric(ephemeris, at)), tdb)
        return found[:, :3], found[:, 3:]

    def spans_s(self) -> list[tuple[float, float]]:
        """What they cover together, TDB seconds since J2000: one span."""
        return [(self.arcs[0].spans_s()[0][0], self.arcs[-1].spans_s()[0][1])]

    @bare_arguments
    def position_partials(self, tdb: Epochs) -> Floats:
        """Partials of the position by the parameters at epochs of TDB, ICRF axes, shape (n, 3, p)."""

        def of_arc(k: int, at: Epochs) -> Floats:
            out = np.zeros((len(at), 3, len(self.names)))
            out[:, :, self.columns[k]] = self.arcs[k].position_partials(at)
            return out

        return self._of_each(of_arc, tdb)

    def over(self, first: Epochs, last: Epochs) -> OrbitArcs:
        """The whole of it: of an arc no more is integrated than it has."""
        return self

    def corrected(self, x: Floats) -> OrbitArcs:
        """The arcs of parameters that are larger by x."""
        arcs = tuple(arc.corrected(x[mine]) for arc, mine in zip(self.arcs, self.columns, strict=True))
        return replace(self, arcs=arcs)


def arcs_of(
    arcs: tuple[AdjustableOrbit, ...],
    borders: Epochs,
    own: Collection[str],
    forces: Forces,
    first_start: Floats,
) -> OrbitArcs:
    """Arcs whose states are their own, and parameters of the forces in `own`, too; others are common.

    `first_start` is how much larger the first state is, shape (6,), where a fit should begin.
    """
    labels: list[list[str]] = []
    for k, arc in enumerate(arcs, 1):
        names = (*STATE, *arc.parameters)
        labels.append([f"{name} {k}" if name in STATE or name in own else name for name in names])
    # States first, as those of one arc are.
    states, others = (
        [label for of_arc in labels for label in of_arc[part]] for part in (slice(6), slice(6, None))
    )
    all_names = tuple(dict.fromkeys(states + others))
    columns = tuple(np.array([all_names.index(label) for label in of_arc]) for of_arc in labels)
    start = np.zeros(len(all_names))
    start[:6] = first_start
    return OrbitArcs(arcs, borders, columns, all_names, forces, start)


AnyOrbit = AdjustableOrbit | OrbitArcs
"""An orbit to be estimated, in one arc or in several."""
