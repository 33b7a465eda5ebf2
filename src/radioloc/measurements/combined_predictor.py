"""Measurements that are linear combinations of simpler ones, predicted by those.

A type with ``Geometry.COMBINED`` says which measurements it combines and with which weights. Their observations are
predicted by another predictor, and values and partials, by whatever parameter, combine with the same weights.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radioloc.ephemeris import Trajectory
from radioloc.measurements.link import Link
from radioloc.measurements.measurement_type import Part
from radioloc.measurements.observations import Observations
from radioloc.measurements.participants import stations_of, targets_of
from radioloc.measurements.physical_model import PhysicalModel
from radioloc.measurements.predictor import Computed, Prediction, Predictor
from radioloc.measurements.registry import KINDS, MEASUREMENTS, kind_of
from radioloc.media.status import first_of


@dataclass(frozen=True, slots=True, eq=False)
class Expanded:
    """Observations as combinations of those of simpler types.

    Parameters
    ----------
    observations : Observations
        Of simple types; those of one combination follow each other. The values are those of the combination.
    first : ndarray of int, shape (n + 1,)
        Where each combination begins, and the end of the last.
    weight : ndarray, shape (k,)
        Weight of each simple observation.
    """

    observations: Observations
    first: NDArray[np.intp]
    weight: NDArray[np.float64]

    def rows(self, which: NDArray[np.intp]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Simple observations of some combinations, shape (k,), and where each combination begins among them."""
        count = self.first[which + 1] - self.first[which]
        begin = np.cumsum(count) - count
        place = np.arange(int(count.sum())) - np.repeat(begin, count)
        return np.repeat(self.first[which], count) + place, begin


def expanded(observations: Observations) -> Expanded:
    """Write observations as combinations of those of simple types, which have one part: themselves."""
    pairs, pair = np.unique(
        observations.kind.astype(np.int64) * len(observations.links) + observations.link, return_inverse=True
    )
    parts: list[tuple[Part, ...]] = []
    for code in pairs.tolist():
        kind, link = (
            KINDS[code // len(observations.links)],
            observations.links[code % len(observations.links)],
        )
        split = MEASUREMENTS[kind].parts
        parts.append((Part(1.0, kind, link),) if split is None else split(link))
    flat = [part for group in parts for part in group]
    links: dict[Link, int] = {}
    link_code = np.array([links.setdefault(part.link, len(links)) for part in flat], dtype=np.int32)
    kind_code = np.array([kind_of(part.type) for part in flat], dtype=np.int8)
    weight = np.array([part.weight for part in flat])
    count = np.array([len(group) for group in parts], dtype=np.intp)
    begin = np.cumsum(count) - count
    of_row = count[pair]
    first = np.concatenate([[0], np.cumsum(of_row)]).astype(np.intp)
    row = np.repeat(np.arange(len(observations)), of_row)
    flat_of = np.repeat(begin[pair], of_row) + (np.arange(len(row)) - np.repeat(first[:-1], of_row))
    simple = replace(
        observations.select(row), kind=kind_code[flat_of], link=link_code[flat_of], links=tuple(links)
    )
    return Expanded(simple, first, weight[flat_of])


class CombinedPredictor:
    """A :class:`~radioloc.measurements.predictor.Predictor` of observations some of which are combinations.

    Parameters
    ----------
    observations : Observations
    parts : Expanded
        The same as combinations.
    inner : Predictor
        Predicts their simple observations.
    """

    def __init__(self, observations: Observations, parts: Expanded, inner: Predictor) -> None:
        self.observations, self.parts, self.inner = observations, parts, inner
        self.stations, self.transmitters, self.receivers, _ = stations_of(inner.model, observations)
        self.target = targets_of(observations, inner.targets)

    @property
    def model(self) -> PhysicalModel:
        """What the predictions rest on."""
        return self.inner.model

    @property
    def trajectory(self) -> Trajectory | None:
        """The target's, if it is a spacecraft."""
        return self.inner.trajectory

    @property
    def targets(self) -> tuple[str, ...]:
        """Names of the targets, where there are several."""
        return self.inner.targets

    @property
    def more_partials(self) -> bool:
        """Whether partials by the stations' places are computed."""
        return self.inner.more_partials

    @property
    def predicted_eop(self) -> NDArray[np.bool_]:
        """Whether an observation rests on predicted Earth orientation, shape (n,)."""
        return np.logical_or.reduceat(self.inner.predicted_eop, self.parts.first[:-1])

    def at(self, lander_pa_m: NDArray[np.float64]) -> CombinedPrediction:
        """The predictions for a position."""
        return CombinedPrediction(self.parts, self.inner.at(lander_pa_m))

    def compute(self, lander_pa_m: NDArray[np.float64]) -> Computed:
        """Predict all observations for a position, with partials."""
        return self.at(lander_pa_m).rows(slice(None))

    def select(self, which: Any) -> CombinedPredictor:
        """The arc of some of the observations (a mask, a slice or indices), already prepared."""
        rows = np.arange(len(self.observations))[which]
        simple, begin = self.parts.rows(rows)
        first = np.append(begin, len(simple))
        part = Expanded(self.parts.observations.select(simple), first, self.parts.weight[simple])
        return CombinedPredictor(self.observations.select(rows), part, self.inner.select(simple))

    def with_values(self, value_m: NDArray[np.float64]) -> CombinedPredictor:
        """The same arc with other measured values, shape (n,), m; nothing is prepared again."""
        return CombinedPredictor(replace(self.observations, value_m=value_m), self.parts, self.inner)

    def terms(self, lander_pa_m: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
        """Table of terms: by how much each active term changes each computed value, m."""
        table = self.inner.terms(lander_pa_m)
        first = self.parts.first[:-1]
        return {name: np.add.reduceat(column * self.parts.weight, first) for name, column in table.items()}


class CombinedPrediction:
    """Predictions of combined observations for one position."""

    def __init__(self, parts: Expanded, inner: Prediction) -> None:
        self._parts, self._inner = parts, inner

    @property
    def value_m(self) -> NDArray[np.float64]:
        """Value of every observation, m, shape (n,)."""
        return np.add.reduceat(self._inner.value_m * self._parts.weight, self._parts.first[:-1])

    def rows(self, which: Any) -> Computed:
        """Values and partials of the rows chosen by a mask, a slice or indices, in that order.

        Partials that belong to the ends of a path (by the position of the target, by the stations) are those of the
        first part where there are several: whoever needs them all asks :meth:`combine`. The elevations are the lowest.
        """
        chosen = np.arange(len(self._parts.first) - 1)[which]
        simple, begin = self._parts.rows(chosen)
        inner, weight = self._inner.rows(simple), self._parts.weight[simple]
        columns = {field.name: getattr(inner, field.name)[begin] for field in fields(Computed)}
        for name in ("value_m", "by_time_m_s", "by_transponder_delay_m_s"):
            columns[name] = np.add.reduceat(getattr(inner, name) * weight, begin)
        columns["elevation_rad"] = np.minimum.reduceat(inner.elevation_rad, begin, axis=0)
        part = np.arange(len(simple)) - np.repeat(begin, np.diff(np.append(begin, len(simple))))
        for k in range(1, int(part.max(initial=0)) + 1):
            rows = np.flatnonzero(part == k)
            owner = np.searchsorted(begin, rows, side="right") - 1
            columns["status"][owner] = first_of(columns["status"][owner], inner.status[rows])
        return Computed(**columns)

    def combine(
        self, which: NDArray[np.intp], columns: Callable[[NDArray[np.intp], Prediction], NDArray[np.float64]]
    ) -> NDArray[np.float64]:
        """What a function gives for the simple observations of some rows, combined; shape (m, ...)."""
        simple, begin = self._parts.rows(which)
        of_simple = columns(simple, self._inner)
        weight = self._parts.weight[simple].reshape(-1, *[1] * (of_simple.ndim - 1))
        return np.add.reduceat(of_simple * weight, begin, axis=0)
