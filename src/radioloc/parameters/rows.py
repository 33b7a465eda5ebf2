"""Rows of observations for partials of parameters: participants, times and computed values."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radioloc.constants import C_M_S
from radioloc.measurements.dense_series import series_codes
from radioloc.measurements.observations import Observations
from radioloc.measurements.physical_model import PhysicalModel
from radioloc.measurements.predictor import Computed, Prediction, Predictor
from radioloc.measurements.prepared_paths import is_radio
from radioloc.measurements.registry import TIME_TAGS, is_differenced, is_integrated, is_one_way
from radioloc.measurements.target_motion import Motions, positions_pa_m
from radioloc.time import Epochs, utc_to_tai, utc_to_tt
from radioloc.time.smooth import evaluate_smooth
from radioloc.vectors import Floats, Indices, Mask, dot, length

TRANSMIT, RECEIVE, BOUNCE = (TIME_TAGS.index(tag) for tag in ("transmit", "receive", "bounce"))

RowFunction = Callable[["ObservationRows"], Any]
_MIN_LONG_ARC = 2**16  # observations, from which on some of them show the members of parameters


class ObservationRows:
    """Observations of a predictor, none of them combined; arrays have the shape (m,).

    Parameters
    ----------
    predictor : Predictor
    rows : ndarray of int, shape (m,), optional
        Indices of the observations; all by default.
    reference : Epochs, optional
        Epoch at which rates contribute nothing, TAI, one; the middle of the arc by default.
    prediction : Prediction, optional
        Prediction of the predictor; without it only the dependence of observations on parameters is known.
    motions : tuple of TargetMotion, optional
        Motions of the targets in the prediction.
    """

    def __init__(
        self,
        predictor: Predictor,
        rows: Indices | None = None,
        reference: Epochs | None = None,
        prediction: Prediction | None = None,
        motions: Motions | None = None,
    ) -> None:
        self.predictor, self._reference = predictor, reference
        self._prediction, self._motions = prediction, motions
        self._selected: Any = slice(None) if rows is None else rows  # all without a copy
        self._results: dict[RowFunction, Any] = {}
        self._unpredicted: ObservationRows | None = None

    def __len__(self) -> int:
        return len(self.predictor.observations if isinstance(self._selected, slice) else self._selected)

    @cached_property
    def rows(self) -> Indices:
        """Indices of the observations."""
        return np.arange(len(self)) if isinstance(self._selected, slice) else self._selected

    def predicted(self, rows: Indices, prediction: Prediction, motions: Motions) -> ObservationRows:
        """Return some of these rows with a prediction; all of them share what depends on none."""
        predicted = ObservationRows(self.predictor, rows, self._reference, prediction, motions)
        if len(rows) == len(self) and np.array_equal(rows, self.rows):
            predicted._unpredicted = self
        return predicted

    def evaluate(self, function: RowFunction) -> Any:
        """Return a function of these rows, evaluated once for all kinds of parameter that share it."""
        if function not in self._results:
            self._results[function] = function(self)
        return self._results[function]

    def evaluate_unpredicted(self, function: RowFunction) -> Any:
        """Return a function that depends on no prediction, evaluated once for all predictions of all rows."""
        return (self._unpredicted or self).evaluate(function)

    @cached_property
    def distinct(self) -> ObservationRows:
        """Observations of a long arc that show its parameters: one of each series, and the last."""
        observations = self.observations
        if len(observations) < _MIN_LONG_ARC:
            return self
        code = series_codes(self.model, observations, more_partials=True)
        sample = np.full(int(code.max()) + 1, int(observations.epoch.mjd.argmax()))
        sample[code] = np.arange(len(code))
        return ObservationRows(self.predictor.select(np.unique(sample)))

    @property
    def model(self) -> PhysicalModel:
        """Physical model of the predictions."""
        return self.predictor.model

    @property
    def observations(self) -> Observations:
        """Complete table that has the rows."""
        return self.predictor.observations

    @cached_property
    def kind(self) -> NDArray[np.int8]:
        """Index of the type in :data:`~radioloc.measurements.registry.KINDS`."""
        return self.observations.kind[self._selected]

    @cached_property
    def tag(self) -> NDArray[np.int8]:
        """Index of the time tag in :data:`~radioloc.measurements.registry.TIME_TAGS`."""
        return self.observations.tag[self._selected]

    @cached_property
    def ends(self) -> NDArray[np.int32]:
        """Index of the first and of the second station, shape (m, 2); -1 without a first station."""
        first, second = self.predictor.transmitters[self._selected], self.predictor.receivers[self._selected]
        return np.stack([np.where(self.one_way, -1, first), second], axis=-1)

    @cached_property
    def one_way(self) -> Mask:
        """Mask of one-way observations: the target transmits and one station receives."""
        return is_one_way(self.kind)

    @cached_property
    def baseline(self) -> Mask:
        """Mask of baselines: the target transmits and two stations receive."""
        return is_differenced(self.kind)

    @cached_property
    def integrated(self) -> Mask:
        """Mask of values that are differences over the count interval."""
        return is_integrated(self.kind)

    @cached_property
    def two_way(self) -> Mask:
        """Mask of two-way observations: one station transmits and receives."""
        return np.asarray(~self.baseline & ~self.one_way & (self.ends[:, 0] == self.ends[:, 1]))

    @cached_property
    def count_s(self) -> Floats:
        """Count interval, s; zero for values without one."""
        return np.where(self.integrated, self.observations.count_s[self._selected], 0.0)

    @cached_property
    def tagged(self) -> Mask:
        """Mask of time tags by the clock of the first and of the second station, shape (m, 2)."""
        first = self.baseline | ((self.tag == TRANSMIT) & ~self.one_way)
        return np.stack([first, ~first & (self.tag == RECEIVE)], axis=-1)

    @property
    def elapsed_s(self) -> Floats:
        """Time tag since the reference epoch, s."""
        return np.asarray(self.evaluate_unpredicted(elapsed_s))

    @cached_property
    def elapsed_at_ends_s(self) -> Floats:
        """Time at the first and second event of the path, s, shape (m, 2).

        The first event is the transmission, of a baseline the first reception. The time is since the reference epoch;
        for an integrated observation it is the length of the count interval at that end.
        """
        flight_s = self.computed.value_m / C_M_S
        lag_fraction = np.where(self.tag == RECEIVE, 1.0, np.where(self.tag == BOUNCE, 0.5, 0.0))
        lag_s = np.where(self.baseline, 0.0, lag_fraction * flight_s)
        first_s = np.where(self.integrated, self.count_s, self.elapsed_s) - lag_s
        return np.stack([first_s, first_s + flight_s], axis=-1)

    @cached_property
    def computed(self) -> Computed:
        """Values and partials that the model computes."""
        assert self._prediction is not None  # for partials only
        return self._prediction.rows(self.rows)

    def displacement_partials(self, displacements: Sequence[Floats]) -> Floats:
        """Return partials with respect to :meth:`displacements` of the target, shape (m, components)."""
        partials = dot(self.computed.by_position_pa[:, None], displacements[0])
        for change in displacements[1:]:
            partials += dot(self.computed.mean_by_position_pa[:, None], change)
        return partials

    def displacements(self, displacement_pa_m: Callable[[Epochs], Floats]) -> list[Floats]:
        """Return displacements of the target at the bounce, and their change in the count if any row has one.

        At k epochs, TDB, `displacement_pa_m` returns the displacement by a unit of each component in principal axes,
        m, shape (k, components, 3). Its periods are two days or more.
        """
        # The bounce at the Moon to 0.1 s, in which quantities with periods of days do not change.
        late = np.where(self.baseline | (self.tag == RECEIVE), -1.0, np.where(self.tag == TRANSMIT, 1.0, 0.0))
        late = np.where(self.one_way & (self.tag == TRANSMIT), 0.0, late)
        met_s = late * self.light_time_s
        halves = (0.0, 0.5, -0.5) if self.integrated.any() else (0.0,)
        middle, *ends = (
            evaluate_smooth(displacement_pa_m, self._rough_tdb.shifted(met_s + half * self.count_s))
            for half in halves
        )
        return [middle, ends[0] - ends[1]] if ends else [middle]

    @property
    def light_time_s(self) -> Floats:
        """Light time, one way, between the centres of Moon and Earth at the time tags, good to 0.03 s for a path."""
        return np.asarray(self.evaluate_unpredicted(_light_time_s))

    @cached_property
    def _rough_tdb(self) -> Epochs:
        """Time tags in TT in place of TDB, good to 2 ms."""
        tt = utc_to_tt(self.observations.epoch[self._selected])
        return Epochs(tt.jd, tt.fraction, "TDB")

    @cached_property
    def radio(self) -> Mask:
        """Mask of radio signals; the others are light."""
        stations = list(map(self.model.catalogue.get, self.predictor.stations))
        return is_radio(self.observations.wavelength_um[self._selected], stations, self.ends[:, 1])

    @property
    def target(self) -> NDArray[np.int32]:
        """Index of the target among the motions."""
        return self.predictor.target[self._selected]

    @property
    def target_pa_m(self) -> Floats:
        """Position of each observation's target on the Moon, principal axes, m, (m, 3); zeros of a spacecraft."""
        assert self._motions is not None  # for partials only
        return positions_pa_m(self._motions)[self.target]


def elapsed_s(rows: ObservationRows) -> Floats:
    """Return the time tags since the reference epoch, s; those of all rows are not kept."""
    reference = middle_epoch(rows.observations) if rows._reference is None else rows._reference
    return utc_to_tai(rows.observations.epoch[rows._selected]).seconds_since(reference)


def _light_time_s(rows: ObservationRows) -> Floats:
    ephemeris = rows.model.ephemeris
    distance_m = evaluate_smooth(lambda at: length(ephemeris.geocentric("moon", at)[0]), rows._rough_tdb)
    return distance_m / C_M_S


def middle_epoch(observations: Observations) -> Epochs:
    """Return the epoch halfway between the first and the last observation, TAI, one."""
    ends = utc_to_tai(observations.span())
    return ends[:1].shifted(0.5 * ends[1:].seconds_since(ends[:1]))


def networks(pairs: NDArray[np.integer[Any]], count: int) -> Indices:
    """Return the number of the connected network of each of `count` items, from pairs of connected items (n, 2)."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    connected = coo_array((np.ones(len(pairs)), tuple(pairs.T)), shape=(count, count))
    return np.asarray(connected_components(connected, directed=False)[1], dtype=np.intp)
