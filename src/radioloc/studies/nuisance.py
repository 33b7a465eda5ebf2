"""The nuisance parameters: what they are called, whom they belong to and what they do to a computed value."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from radioloc.constants import C_M_S
from radioloc.estimation.linearization import ROWS_AT_ONCE
from radioloc.measurements.measurement_type import TIME_TAGS
from radioloc.measurements.observations import RANGE, VLBI_DELAY, VLBI_DELAY_RATE
from radioloc.measurements.predictor import Computed, Predictor
from radioloc.measurements.registry import is_differenced
from radioloc.time import Epochs, utc_to_tai


class ArcRows:
    """Some observations of an arc, as nuisance parameters see them; arrays of shape (m,).

    Parameters
    ----------
    arc : Predictor
    rows : ndarray of int, shape (m,), optional
        Which observations; all by default.
    computed : callable, optional
        From rows to what the arc computes of them, asked when :attr:`computed` is.
    middle : Epochs, optional
        Middle of the arc, TAI, one epoch.
    """

    def __init__(
        self,
        arc: Predictor,
        rows: NDArray[np.intp] | None = None,
        computed: Callable[[NDArray[np.intp]], Computed] | None = None,
        middle: Epochs | None = None,
    ) -> None:
        self.arc = arc
        self.rows = np.arange(len(arc.transmitters)) if rows is None else rows
        self._compute = computed
        self._computed: Computed | None = None
        self._middle = middle

    def __len__(self) -> int:
        return len(self.rows)

    @property
    def kind(self) -> NDArray[np.int8]:
        """Index into :data:`~radioloc.measurements.registry.KINDS`."""
        return self.arc.observations.kind[self.rows]

    @property
    def tag(self) -> NDArray[np.int8]:
        """Index into :data:`~radioloc.measurements.measurement_type.TIME_TAGS`."""
        return self.arc.observations.tag[self.rows]

    @property
    def transmitters(self) -> NDArray[np.int32]:
        """Index of the first station."""
        return self.arc.transmitters[self.rows]

    @property
    def receivers(self) -> NDArray[np.int32]:
        """Index of the second station."""
        return self.arc.receivers[self.rows]

    @property
    def elapsed_s(self) -> NDArray[np.float64]:
        """Time since the middle of the arc, s."""
        middle = middle_of(self.arc) if self._middle is None else self._middle
        return utc_to_tai(self.arc.observations.epoch[self.rows]).seconds_since(middle)

    @property
    def computed(self) -> Computed | None:
        """What the arc computes of these observations; None before there is a position."""
        if self._computed is None and self._compute is not None:
            self._computed = self._compute(self.rows)
        return self._computed


def middle_of(arc: Predictor) -> Epochs:
    """Half way between an arc's first and last observation, TAI, one epoch."""
    epoch = arc.observations.epoch
    days = (epoch.jd - epoch.jd.min()) + epoch.fraction
    ends = utc_to_tai(epoch[[int(days.argmin()), int(days.argmax())]])
    return ends[:1].shifted(0.5 * ends[1:].seconds_since(ends[:1]))


Shares = Callable[[ArcRows], NDArray[np.float64]]
"""Partials by the parameter of the first and of the second station of each observation, shape (m, 2)."""


@dataclass(frozen=True, slots=True, eq=False)
class Owner:
    """Whom a parameter belongs to.

    Parameters
    ----------
    station : int or None
        Index into the arc's stations; None for the point.
    name : str
        The station's name, with the number of the pass where each has its own.
    number : int
        Of the pass.
    pass_of : ndarray of int, shape (n,), or None
        Number of the pass that each observation of the arc is of; None where the parameter is of all.
    span_utc : tuple of str, or None
        First and last epoch of the pass.
    """

    station: int | None
    name: str
    number: int = 0
    pass_of: NDArray[np.int32] | None = None
    span_utc: tuple[str, str] | None = None


@dataclass(frozen=True, slots=True)
class Nuisance:
    """One kind of parameter, of which each station can have its own, or the point has the only one.

    Parameters
    ----------
    key : str
        Name of the kind, and of the list of stations in ``[estimate]``; the key of the a-priori value adds the unit,
        that of its sigma ``_sigma`` and the unit.
    unit : str
        Unit of the parameter.
    scale : float
        A change worth about one metre.
    shares : callable
        What the parameters of an observation's two stations do to its value. Where nothing is computed yet it may give
        any non-zero partials where there are some.
    of_stations : bool
        Whether stations have it rather than the point.
    """

    key: str
    unit: str
    scale: float
    shares: Shares
    of_stations: bool = True

    @property
    def value_key(self) -> str:
        """Key of the a-priori value in ``[estimate]``."""
        return f"{self.key}_{self.unit.replace('/', '_')}"

    @property
    def sigma_key(self) -> str:
        """Key of the a-priori value's sigma in ``[estimate]``."""
        return f"{self.key}_sigma_{self.unit.replace('/', '_')}"

    def stations(self, arc: Predictor) -> list[int]:
        """Indices of the stations with observations that such a parameter acts on."""
        taking_part: set[int] = set()
        n = len(arc.transmitters)
        for start in range(0, n, ROWS_AT_ONCE):
            part = ArcRows(arc, np.arange(start, min(start + ROWS_AT_ONCE, n)))
            acts = self.shares(part) != 0.0
            taking_part |= set(np.unique(part.transmitters[acts[:, 0]]).tolist())
            taking_part |= set(np.unique(part.receivers[acts[:, 1]]).tolist())
        return sorted(taking_part)

    def columns(self, part: ArcRows, owners: Sequence[Owner]) -> NDArray[np.float64]:
        """Partials of some observations by the parameters of some owners, shape (m, number of owners)."""
        if not owners:
            return np.zeros((len(part), 0))
        shares = self.shares(part)
        if not self.of_stations:
            return shares.sum(axis=-1, keepdims=True)
        # Column by column in memory: several times as fast as row by row.
        columns = np.zeros((len(owners), len(part)))
        ends = (part.transmitters, shares[:, 0].copy()), (part.receivers, shares[:, 1].copy())
        for column, owner in zip(columns, owners, strict=True):
            for station, share in ends:
                column += np.where(station == owner.station, share, 0.0)
            if owner.pass_of is not None:
                column *= owner.pass_of[part.rows] == owner.number
        return columns.T


def _range_bias(part: ArcRows) -> NDArray[np.float64]:
    ranges = (part.kind == RANGE).astype(np.float64)
    return np.stack([np.zeros_like(ranges), ranges], axis=-1)


def _time_bias(part: ArcRows) -> NDArray[np.float64]:
    """The tag belongs to the transmitter if it names the transmission, and to the first station of a delay."""
    first = is_differenced(part.kind) | (part.tag == TIME_TAGS.index("transmit"))
    computed = part.computed
    by_time = np.ones(len(part)) if computed is None else computed.by_time_m_s
    return np.stack([np.where(first, by_time, 0.0), np.where(first, 0.0, by_time)], axis=-1)


def _clock(part: ArcRows) -> NDArray[np.float64]:
    """A clock that is ahead reads an arrival later: the second station's adds to the delay, but not to its growth.

    The first station's is taken off, and moves the tag: the arrival that it reads at the tag was before it.
    """
    delays = (part.kind == VLBI_DELAY) * C_M_S
    return np.stack([-delays - _moved_tag(part), delays], axis=-1)


def _clock_rate(part: ArcRows) -> NDArray[np.float64]:
    """Times the time since the middle of the arc, which hardly ties it to the offset, or times the count interval."""
    shares, rates, computed = _clock(part), part.kind == VLBI_DELAY_RATE, part.computed
    grown = np.zeros_like(shares)
    if rates.any():
        grown[rates] = (C_M_S * part.arc.observations.count_s[part.rows][rates])[:, None] * np.array(
            [-1.0, 1.0]
        )
        if computed is not None:
            # The first station's clock counts the interval too, in which the delay grows.
            grown[rates, 0] -= computed.value_m[rates]
    # A partial at the middle is zero, but its stations take part: the time counts where there is a position.
    return shares + grown if computed is None else shares * part.elapsed_s[:, None] + grown


def _moved_tag(part: ArcRows) -> NDArray[np.float64]:
    """How delays and their growth change with the tag, m/s; nothing before there is a position."""
    computed = part.computed
    return (
        np.zeros(len(part))
        if computed is None
        else np.where(is_differenced(part.kind), computed.by_time_m_s, 0.0)
    )


def _zenith_delay(part: ArcRows) -> NDArray[np.float64]:
    computed = part.computed
    return np.ones((len(part), 2)) if computed is None else computed.by_zenith_wet


def _transponder_delay(part: ArcRows) -> NDArray[np.float64]:
    """Of the point: shared by nobody, put down as the second station's."""
    computed = part.computed
    over = ~is_differenced(part.kind) if computed is None else computed.by_transponder_delay_m_s
    return np.stack([np.zeros(len(part)), over.astype(np.float64)], axis=-1)


NUISANCES = (
    Nuisance("range_bias", "m", 1.0, _range_bias),
    Nuisance("time_bias", "s", 1e-3, _time_bias),
    Nuisance("clock", "s", 1.0 / C_M_S, _clock),
    Nuisance("clock_rate", "s/s", 1e-5 / C_M_S, _clock_rate),
    Nuisance("zenith_delay", "m", 0.3, _zenith_delay),
    Nuisance("transponder_delay", "s", 1.0 / C_M_S, _transponder_delay, of_stations=False),
)
"""The kinds: a bias of the receiver's ranges; an offset of the time tags; offset and rate of a VLBI station's clock;
what the wet delay at the zenith, and the delay of the point's transponder, are beyond the model."""
