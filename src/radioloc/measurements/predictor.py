"""What an arc offers, however it evaluates the model: predictions of all observations or of some rows.

:class:`~radioloc.measurements.exact_predictor.ExactPredictor` computes each observation by itself;
:class:`~radioloc.measurements.chebyshev_predictor.ChebyshevPredictor` interpolates dense series between nodes. Whoever
fits, simulates or plots asks for a :class:`Predictor` and need not know which it is.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from radioloc.ephemeris import Trajectory
from radioloc.measurements.observations import Observations
from radioloc.measurements.physical_model import PhysicalModel
from radioloc.measurements.terms import TERMS
from radioloc.media.status import describe

ROWS_AT_ONCE = 65536
"""Rows of partials, or of what else belongs to observations, that are held together: 8 MB for 15 parameters."""


@dataclass(frozen=True, slots=True)
class Computed:
    """Predicted observations and how they change.

    Parameters
    ----------
    value_m : ndarray, shape (n,)
        Range, delay or range difference over the count interval, m.
    by_position_pa : ndarray, shape (n, 3)
        Partial derivatives with respect to the principal-axes coordinates of the observation's target, m/m.
    by_time_m_s : ndarray, shape (n,)
        Partial derivative with respect to the time tag, m/s.
    by_transponder_delay_m_s : ndarray, shape (n,)
        Partial derivative with respect to the time for which the point holds the signal, m/s: the speed of light to
        1e-5 for ranges, zero for VLBI delays and next to nothing for what is counted.
    by_zenith_wet : ndarray, shape (n, 2)
        Partial derivatives with respect to the wet zenith delay at the first and at the second station, m/m.
    elevation_rad : ndarray, shape (n, 2)
        Elevation of the point above the transmitter's and the receiver's horizon, without refraction. For Doppler and
        delay rates that at the end of the count interval, or at its start if the point is below the horizon only then.
    status : ndarray of int8, shape (n, 2)
        :class:`~radioloc.media.status.Status` at both ends: whether the model holds there, or why not.
    by_station_itrf : ndarray, shape (n, 2, 3)
        Partial derivatives with respect to the ITRF coordinates of the first and of the second station, m/m; where they
        were not asked for the shape is (n, 0, 3).
    by_electron_content_m : ndarray, shape (n, 2)
        Partial derivatives with respect to the vertical electron content above the two stations, m/TECU, NaN without a
        frequency; where they were not asked for the shape is (n, 0).
    mean_by_position_pa : ndarray, shape (n, 3)
        Of a difference over a count interval, the mean of the partials by position at its two ends, which what moves
        the target in the interval acts by; else as `by_position_pa`. Where it was not asked for the shape is (n, 0).
    """

    value_m: NDArray[np.float64]
    by_position_pa: NDArray[np.float64]
    by_time_m_s: NDArray[np.float64]
    by_transponder_delay_m_s: NDArray[np.float64]
    by_zenith_wet: NDArray[np.float64]
    elevation_rad: NDArray[np.float64]
    status: NDArray[np.int8]
    by_station_itrf: NDArray[np.float64]
    by_electron_content_m: NDArray[np.float64]
    mean_by_position_pa: NDArray[np.float64]

    def rows(self, which: Any) -> Computed:
        """Some of the rows, chosen by a mask, a slice or indices."""
        return Computed(
            self.value_m[which],
            self.by_position_pa[which],
            self.by_time_m_s[which],
            self.by_transponder_delay_m_s[which],
            self.by_zenith_wet[which],
            self.elevation_rad[which],
            self.status[which],
            self.by_station_itrf[which],
            self.by_electron_content_m[which],
            self.mean_by_position_pa[which],
        )

    @property
    def usable(self) -> NDArray[np.bool_]:
        """Whether the model holds for an observation, shape (n,)."""
        return np.asarray(~self.status.any(axis=-1))


class Prediction(Protocol):
    """The observations of an arc predicted for one position: the values at once, all else for the rows asked for."""

    @property
    def value_m(self) -> NDArray[np.float64]:
        """Range, delay or range difference over the count interval of every observation, m, shape (n,)."""
        ...

    def rows(self, which: Any) -> Computed:
        """Values and partials of the rows chosen by a mask, a slice or indices, in that order."""
        ...


class Predictor(Protocol):
    """The observations of one arc, prepared for predictions from any position near an approximate one."""

    @property
    def model(self) -> PhysicalModel:
        """What the predictions rest on."""
        ...

    @property
    def observations(self) -> Observations:
        """What is predicted."""
        ...

    @property
    def trajectory(self) -> Trajectory | None:
        """The target's, if it is a spacecraft and no point fixed to the Moon."""
        ...

    @property
    def stations(self) -> tuple[str, ...]:
        """Names of the stations that take part, each once."""
        ...

    @property
    def transmitters(self) -> NDArray[np.int32]:
        """Index into :attr:`stations` of each observation's transmitter, shape (n,)."""
        ...

    @property
    def receivers(self) -> NDArray[np.int32]:
        """Index into :attr:`stations` of each observation's receiver, shape (n,)."""
        ...

    @property
    def targets(self) -> tuple[str, ...]:
        """Names of the targets, in the order of the positions; empty where there is only one."""
        ...

    @property
    def more_partials(self) -> bool:
        """Whether partials by the stations' places and by the electron content above them are computed."""
        ...

    @property
    def target(self) -> NDArray[np.int32]:
        """Index of each observation's target among the positions, shape (n,)."""
        ...

    @property
    def predicted_eop(self) -> NDArray[np.bool_]:
        """Whether an observation rests on predicted Earth orientation, shape (n,)."""
        ...

    def compute(self, lander_pa_m: NDArray[np.float64]) -> Computed:
        """Predict all observations for a position, principal axes, m, shape (3,)."""
        ...

    def at(self, lander_pa_m: NDArray[np.float64]) -> Prediction:
        """The predictions for a position, whose partials are had in blocks of rows.

        With several targets the positions are an array of shape (n_targets, 3).
        """
        ...

    def select(self, which: Any) -> Predictor:
        """The arc of some of the observations (a mask, a slice or indices), already prepared."""
        ...

    def with_values(self, value_m: NDArray[np.float64]) -> Predictor:
        """The same arc with other measured values, shape (n,), m; nothing is prepared again."""

    def terms(self, lander_pa_m: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
        """Table of terms: by how much each active term changes each computed value, m."""
        ...


def reasons(
    predictor: Predictor, computed: Computed, which: Any = slice(None)
) -> tuple[NDArray[np.int8], NDArray[np.str_]]:
    """Why observations cannot be used.

    Parameters
    ----------
    predictor : Predictor
        Knows the stations.
    computed : Computed
        Its prediction of some rows.
    which : mask, slice or indices
        Those rows.

    Returns
    -------
    code : ndarray of int8, shape (n,)
        :class:`~radioloc.media.status.Status` at the first end where it is not OK.
    text : ndarray of str, shape (n,)
        The same in words; empty where nothing is wrong.
    """
    ends = np.stack([predictor.transmitters[which], predictor.receivers[which]], axis=-1)
    return describe(computed.status, computed.elevation_rad, predictor.stations, ends)


def blocks(predictor: Predictor) -> Iterator[NDArray[np.intp]]:
    """Rows of a predictor, some ten thousand at a time."""
    n = len(predictor.observations)
    for start in range(0, n, ROWS_AT_ONCE):
        yield np.arange(start, min(start + ROWS_AT_ONCE, n))


def table_of_terms(
    arc: Predictor,
    lander_pa_m: NDArray[np.float64],
    prepare: Callable[[PhysicalModel, Observations, NDArray[np.float64]], Predictor],
    skip: Collection[str] = (),
) -> dict[str, NDArray[np.float64]]:
    """By how much each active term changes each computed value, m.

    Parameters
    ----------
    arc : Predictor
    lander_pa_m : ndarray, shape (3,)
        The point in principal axes, m.
    prepare : callable
        What prepares an arc for a model, observations and a position.
    skip : collection of str
        Terms that cannot matter.

    Returns
    -------
    dict of str to ndarray, shape (n,)
        Computed with everything minus computed without that term, in the order of
        :data:`~radioloc.measurements.terms.TERMS`.
    """
    full_m = arc.at(lander_pa_m).value_m
    table = {}
    for name in (*TERMS, *(medium.name for medium in arc.model.added_media if medium.name not in TERMS)):
        if arc.model.has(name) and name not in skip:
            without = prepare(arc.model.without(name), arc.observations, lander_pa_m)
            table[name] = full_m - without.at(lander_pa_m).value_m
    return table
