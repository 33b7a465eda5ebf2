"""Interface of predictors of the observations of an arc."""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from radioloc.earth.stations import Station
from radioloc.ephemeris.trajectory import SpacecraftTrajectory
from radioloc.errors import InputError, StationError
from radioloc.measurements.link import canonical_target
from radioloc.measurements.observations import Observations
from radioloc.measurements.physical_model import TERMS, PhysicalModel
from radioloc.measurements.target_motion import Motions, MotionsLike, as_motions
from radioloc.media.medium import describe
from radioloc.quantities import accepts_quantities
from radioloc.vectors import Floats, Indices, Mask

ROWS_AT_ONCE = 16384  # rows of partials that are held together: 10 MB for 75 parameters
_LANDER_TERMS = ("lunar_tide", "lunar_tide_constant", "lunar_scale", "lunar_lorentz")
"""Terms of a point fixed to the Moon, which have no part in a trajectory."""


@dataclass(frozen=True, slots=True)
class Computed:
    """Predicted observations and their partial derivatives."""

    value_m: Floats  #: (n,), range, delay or range difference over the count interval, m
    #: (n, 3), partial derivatives with respect to the principal-axes coordinates of the observation's target,
    #: m/m.
    by_position_pa: Floats
    by_time_m_s: Floats  #: (n,), partial derivative with respect to the time tag, m/s
    #: (n,), partial derivative with respect to the delay of the transponder, m/s: the speed of light to 1e-5 for
    #: ranges, zero for VLBI delays, and very small for counts.
    by_transponder_delay_m_s: Floats
    #: (n, 2), partial derivatives with respect to the wet zenith delay at the first and at the second station,
    #: m/m.
    by_zenith_wet: Floats
    #: (n, 2), elevation of the target above the horizon of the transmitter and the receiver, without refraction;
    #: for counts at the end of the interval, or at its start if the target is below the horizon only there.
    elevation_rad: Floats
    status: NDArray[np.int8]  #: (n, 2), :class:`~radioloc.media.medium.Status` of the model at both ends
    #: (n, 2, 3), partial derivatives with respect to the ITRF coordinates of the first and of the second
    #: station, m/m; shape (n, 0, 3) without ``more_partials``.
    by_station_itrf: Floats
    #: (n, 2), partial derivatives with respect to the vertical electron content above both stations, m/TECU, NaN
    #: without a frequency; shape (n, 0) without ``more_partials``.
    by_electron_content_m: Floats
    #: (n, 3), mean d(value)/d(position) of both ends of a count interval, for displacements during the
    #: interval; else as `by_position_pa`; shape (n, 0) without ``more_partials``.
    mean_by_position_pa: Floats
    #: (n, p), partial derivatives with respect to the parameters of the motions, target by target, m per unit of
    #: each; zeros in rows of other targets. For a single point fixed to the Moon they are `by_position_pa`.
    by_motion: Floats

    def __repr__(self) -> str:
        return f"<Computed {len(self.value_m)} observations, {int((~self.usable).sum())} unusable>"

    def rows(self, rows: Any) -> Computed:
        """Return rows by a mask, a slice or indices."""
        is_shared = self.by_motion is self.by_position_pa
        names = [field.name for field in fields(self) if not (is_shared and field.name == "by_motion")]
        columns = {name: getattr(self, name)[rows] for name in names}
        return Computed(**{"by_motion": columns["by_position_pa"], **columns})

    @property
    def usable(self) -> Mask:
        """Mask of observations within the validity of the model, shape (n,)."""
        return np.asarray(~self.status.any(axis=-1))


class Prediction(Protocol):
    """Predictions of an arc for some motions: values of all rows, and partials of rows on request."""

    @property
    def value_m(self) -> Floats:
        """Range, delay or range difference over the count interval of all observations, m, shape (n,)."""
        ...

    def rows(self, rows: Any) -> Computed:
        """Return values and partials of rows by a mask, a slice or indices, in that order."""
        ...


class Predictor(ABC):
    """Observations of an arc, prepared for predictions by motions of the targets near approximate motions.

    Attributes
    ----------
    model : PhysicalModel
        Kernels, tables and active terms.
    observations : Observations
        Predicted observations.
    motions : tuple of TargetMotion
        Approximate motions of the targets.
    targets : tuple of str
        Names of the targets in the order of the motions; empty for a single target.
    target : ndarray of int32, shape (n,)
        Index of each observation's target among the motions; -1 for a source at infinity.
    stations : tuple of str
        Names of the participating stations.
    transmitters, receivers : ndarray of int32, shape (n,)
        Indices into ``stations`` of each observation's first and second station, which are equal for one-way.
    more_partials : bool
        Whether partials with respect to station positions and electron contents are computed.
    """

    def __init__(
        self,
        model: PhysicalModel,
        observations: Observations,
        motions: MotionsLike,
        targets: Sequence[str] = (),
        more_partials: bool = False,
    ) -> None:
        self.model, self.targets, self.more_partials = model, tuple(targets), more_partials
        self.motions = as_motions(motions, model, self.targets)
        self._set_observations(observations)

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {len(self.observations)} observations by {', '.join(self.stations)}>"

    def _set_observations(self, observations: Observations) -> None:
        """Set the observations, and find their stations and targets in the order of their links."""
        self.observations = observations
        stations: dict[str, Station] = {}
        position = {canonical_target(name): k for k, name in enumerate(self.targets)}
        ends = np.zeros((len(observations.links), 3), dtype=np.int32)
        directions = np.zeros((len(observations.links), 3))
        for i in np.flatnonzero(np.bincount(observations.link, minlength=len(observations.links))):
            link, origin = observations.links[i], observations.origin(int(np.argmax(observations.link == i)))
            for end, name in enumerate((link.transmitter or link.receiver, link.receiver)):
                try:
                    station = self.model.catalogue.get(name)
                except StationError as error:
                    raise StationError(f"{origin}: {error}") from None
                stations.setdefault(station.name, station)
                ends[i, end] = list(stations).index(station.name)
            source = self.model.sources.get(canonical_target(link.target))
            if source is not None:
                if not link.differenced:
                    raise InputError(
                        f"{origin}: {link.path}: expected a VLBI delay of the source at infinity {link.target}"
                    )
                ends[i, 2], directions[i] = -1, source
            elif self.targets:
                if canonical_target(link.target) not in position:
                    raise InputError(
                        f"{origin}: target: expected {' or '.join(self.targets)}, got {link.target!r}"
                    )
                ends[i, 2] = position[canonical_target(link.target)]
        self.stations, self._stations = tuple(stations), tuple(stations.values())
        self.transmitters, self.receivers, self.target = (column[observations.link] for column in ends.T)
        self._directions = directions  # of sources at infinity, by link

    @property
    def uncombined(self) -> Predictor:
        """Predictor of the observations before they are combined."""
        return self

    @property
    @abstractmethod
    def predicted_eop(self) -> Mask:
        """Mask of observations with predicted Earth orientation, shape (n,)."""

    @property
    def trajectories(self) -> tuple[SpacecraftTrajectory, ...]:
        """Trajectories of the spacecraft."""
        return tuple(motion.trajectory for motion in self.motions if motion.trajectory is not None)

    def _given(self, motions: MotionsLike | None) -> Motions:
        """Return motions; by default those of the prepared arc."""
        return self.motions if motions is None else as_motions(motions, self.model, self.targets)

    @abstractmethod
    def predict(self, motions: MotionsLike | None = None) -> Prediction:
        """Predict all values, and partials of rows on request.

        Parameters
        ----------
        motions : TargetMotion, LunarPosition or trajectory, or a sequence of them
            Motions of the targets in their order, near those of the prepared arc, which are the default.
        """

    @abstractmethod
    def select(self, rows: Any) -> Predictor:
        """Return the prepared arc of some observations by a mask, a slice or indices.

        Preparation is most of the work of an arc, so shorter arcs should be selected from the longest one.
        """

    def with_motions(self, motions: MotionsLike) -> Self:
        """Return the arc with other approximate motions, near those of its preparation."""
        arc = copy.copy(self)
        arc.motions = self._given(motions)
        return arc

    @abstractmethod
    def with_model(self, model: PhysicalModel, motions: MotionsLike | None = None) -> Predictor:
        """Prepare the same observations with another model, for values only."""

    def compute(self, motions: MotionsLike | None = None) -> Computed:
        """Predict all observations, with partials; the argument is that of :meth:`predict`."""
        return self.predict(motions).rows(slice(None))

    @accepts_quantities
    def with_values(self, value_m: Floats) -> Self:
        """Return the arc with other measured values, shape (n,), m, without preparation."""
        arc = copy.copy(self)
        arc.observations = replace(self.observations, value_m=value_m)
        return arc

    def terms(self, motions: MotionsLike | None = None, names: Iterable[str] = TERMS) -> dict[str, Floats]:
        """Return the effect of each active term, of those named, on each computed value, m, shape (n,).

        The effect is the value with all terms less the value without the term, in the order of the names, by default
        that of :data:`~radioloc.measurements.physical_model.TERMS`.
        """
        all_motions = self._given(motions)
        full_m = self.predict(all_motions).value_m
        has_lander = any(motion.trajectory is None for motion in all_motions)
        table = {}
        for name in names:
            if self.model.has(name) and (has_lander or name not in _LANDER_TERMS):
                reduced = self.with_model(self.model.without(name), all_motions)
                table[name] = full_m - reduced.predict(all_motions).value_m
        return table


def reasons(
    predictor: Predictor, computed: Computed, rows: Any = slice(None)
) -> tuple[NDArray[np.int8], NDArray[np.str_]]:
    """Return the first failed status of each predicted row, and its text, shapes (n,)."""
    # `computed` are predictions of `rows`; texts of usable observations are empty.
    ends = np.stack([predictor.transmitters[rows], predictor.receivers[rows]], axis=-1)
    return describe(computed.status, computed.elevation_rad, predictor.stations, ends)


def blocks(predictor: Predictor) -> Iterator[Indices]:
    """Yield blocks of rows of a predictor."""
    n = len(predictor.observations)
    for start in range(0, n, ROWS_AT_ONCE):
        yield np.arange(start, min(start + ROWS_AT_ONCE, n))
