"""Predictions of measurements that are linear combinations of simple measurements.

A type with ``Geometry.COMBINED`` defines the simple measurements and their weights. Another predictor predicts the
simple observations; values and partials combine with the same weights.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import numpy as np

from radioloc.errors import InputError
from radioloc.measurements.link import Link
from radioloc.measurements.observations import Observations
from radioloc.measurements.physical_model import PhysicalModel
from radioloc.measurements.predictor import Computed, Prediction, Predictor
from radioloc.measurements.registry import KINDS, MEASUREMENTS, Part, kind_of
from radioloc.measurements.target_motion import Motions, MotionsLike
from radioloc.media.medium import first_failure
from radioloc.plugins import entry_errors
from radioloc.vectors import Floats, Indices, Mask


@dataclass(frozen=True, slots=True, eq=False)
class Combinations:
    """Consecutive simple observations of each combination."""

    first: Indices  # start of each combination, and the end of the last, shape (n + 1,)
    weight: Floats  # of each simple observation

    def rows(self, index: Indices) -> tuple[Indices, Indices]:
        """Return the simple observations of some combinations, shape (k,), and the start of each among them."""
        count = self.first[index + 1] - self.first[index]
        begin = np.cumsum(count) - count
        return np.repeat(self.first[index] - begin, count) + np.arange(int(count.sum())), begin


def expanded(observations: Observations) -> tuple[Observations, Combinations]:
    """Return observations of simple types and their combinations; a simple observation is its only part."""
    links = observations.links
    pairs, pair = np.unique(
        observations.kind.astype(np.int64) * len(links) + observations.link, return_inverse=True
    )
    parts = [_parts(KINDS[code // len(links)], links[code % len(links)]) for code in pairs.tolist()]
    flat = [part for group in parts for part in group]
    simple_links: dict[Link, int] = {}
    link_code = np.array(
        [simple_links.setdefault(part.link, len(simple_links)) for part in flat], dtype=np.int32
    )
    kind_code = np.array([kind_of(part.type) for part in flat], dtype=np.int8)
    count = np.array([len(group) for group in parts], dtype=np.intp)
    of_pairs = Combinations(np.concatenate([[0], np.cumsum(count)]), np.array([part.weight for part in flat]))
    part, begin = of_pairs.rows(pair)
    simple = replace(
        observations.select(np.repeat(np.arange(len(observations)), count[pair])),
        kind=kind_code[part],
        link=link_code[part],
        links=tuple(simple_links),
    )
    return simple, Combinations(np.append(begin, len(part)), of_pairs.weight[part])


def _parts(kind: str, link: Link) -> tuple[Part, ...]:
    """Return the parts of a type of measurement; a simple type is its only part."""
    split = MEASUREMENTS[kind].parts
    if split is None:
        return (Part(1.0, kind, link),)
    with entry_errors(f"type of measurement {kind}", "parts"):
        parts = tuple(split(link))
    simple = [name for name, item in MEASUREMENTS.items() if item.parts is None]
    if not parts or not all(isinstance(part, Part) and part.type in simple for part in parts):
        raise InputError(
            f"measurement type {kind}: parts: expected Part(weight, type, link) with types of "
            f"{', '.join(simple)}, got {parts!r}"
        )
    return parts


class CombinedPredictor(Predictor):
    """Predictor of observations that combine those of the predictor `inner` as `parts` states."""

    def __init__(self, observations: Observations, parts: Combinations, inner: Predictor) -> None:
        super().__init__(inner.model, observations, inner.motions, inner.targets, inner.more_partials)
        self.parts, self.inner = parts, inner

    @property
    def uncombined(self) -> Predictor:
        """Predictor of the observations before they are combined."""
        return self.inner

    @property
    def predicted_eop(self) -> Mask:
        """Mask of observations with predicted Earth orientation, shape (n,)."""
        return np.logical_or.reduceat(self.inner.predicted_eop, self.parts.first[:-1])

    def predict(self, motions: MotionsLike | None = None) -> CombinedPrediction:
        """Return the predictions for motions."""
        return CombinedPrediction(self, self._given(motions))

    def select(self, rows: Any) -> CombinedPredictor:
        """Return the prepared arc of some observations by a mask, a slice or indices."""
        rows = np.arange(len(self.observations))[rows]
        simple, begin = self.parts.rows(rows)
        parts = Combinations(np.append(begin, len(simple)), self.parts.weight[simple])
        return CombinedPredictor(self.observations.select(rows), parts, self.inner.select(simple))

    def with_motions(self, motions: MotionsLike) -> CombinedPredictor:
        """Return the arc with other motions, as :meth:`Predictor.with_motions`."""
        return CombinedPredictor(self.observations, self.parts, self.inner.with_motions(motions))

    def with_model(self, model: PhysicalModel, motions: MotionsLike | None = None) -> CombinedPredictor:
        """Prepare the same observations with another model, for values only."""
        inner = self.inner.with_model(model, self._given(motions))
        return CombinedPredictor(self.observations, self.parts, inner)


class CombinedPrediction:
    """Predictions of observations that combine simple ones."""

    def __init__(self, predictor: CombinedPredictor, motions: Motions) -> None:
        self._n, self._parts, self._simple = len(predictor.observations), predictor.parts, predictor.inner
        self._prediction = predictor.inner.predict(motions)

    @cached_property
    def value_m(self) -> Floats:
        """Values of all observations, m, shape (n,)."""
        return np.asarray(
            np.add.reduceat(self._prediction.value_m * self._parts.weight, self._parts.first[:-1])
        )

    def rows(self, rows: Any) -> Computed:
        """Return values and partials of rows; elevations are the lowest of the parts, others of ends of the first."""
        simple, begin = self._parts.rows(np.arange(self._n)[rows])
        inner, weight = self._prediction.rows(simple), self._parts.weight[simple]
        columns = {field.name: getattr(inner, field.name)[begin] for field in fields(Computed)}
        for name in ("value_m", "by_time_m_s", "by_transponder_delay_m_s"):
            columns[name] = np.add.reduceat(getattr(inner, name) * weight, begin)
        columns["by_motion"] = np.add.reduceat(inner.by_motion * weight[:, None], begin, axis=0)
        columns["elevation_rad"] = np.minimum.reduceat(inner.elevation_rad, begin, axis=0)
        part = np.arange(len(simple)) - np.repeat(begin, np.diff(np.append(begin, len(simple))))
        for k in range(1, int(part.max(initial=0)) + 1):
            of_part = np.flatnonzero(part == k)
            owner = np.searchsorted(begin, of_part, side="right") - 1
            columns["status"][owner] = first_failure(columns["status"][owner], inner.status[of_part])
        return Computed(**columns)

    def combine(self, rows: Indices, columns: Callable[[Indices, Prediction], Floats]) -> Floats:
        """Combine the columns that a function returns for rows of the simple predictor, shape (m, ...)."""
        simple, begin = self._parts.rows(np.arange(self._n)[rows])
        combined = columns(simple, self._prediction)
        weight = self._parts.weight[simple].reshape(-1, *[1] * (combined.ndim - 1))
        return np.asarray(np.add.reduceat(combined * weight, begin, axis=0))
