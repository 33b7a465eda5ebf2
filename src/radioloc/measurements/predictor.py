"""Predictors of the observations of an arc, of all or of some rows, whichever way they evaluate the model."""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from radioloc.earth.stations import Station
from radioloc.ephemeris.trajectory import AnyTrajectory
from radioloc.errors import InputError, StationError
from radioloc.measurements.link import canonical_target
from radioloc.measurements.observations import Observations
from radioloc.measurements.physical_model import PhysicalModel
from radioloc.measurements.target_motion import GivenMotions, Motions, as_motions
from radioloc.measurements.terms import TERMS
from radioloc.media.status import describe
from radioloc.quantities import accepts_quantities
from radioloc.vectors import Floats

ROWS_AT_ONCE = 16384  # rows of partials that are held together: 10 MB for 75 parameters
_LANDER_TERMS = ("lunar_tide", "lunar_tide_constant", "lunar_scale", "lunar_lorentz")
"""Terms of a point fixed to the Moon, which have no part in a trajectory."""


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
    by_motion : ndarray, shape (n, p)
        Partial derivatives with respect to the parameters of the motions, target by target, m per unit of each; zeros
        in rows of other targets. Of one point fixed to the Moon they are `by_position_pa`.
    """

    value_m: Floats
    by_position_pa: Floats
    by_time_m_s: Floats
    by_transponder_delay_m_s: Floats
    by_zenith_wet: Floats
    elevation_rad: Floats
    status: NDArray[np.int8]
    by_station_itrf: Floats
    by_electron_content_m: Floats
    mean_by_position_pa: Floats
    by_motion: Floats

    def __repr__(self) -> str:
        return f"<Computed {len(self.value_m)} observations, {int((~self.usable).sum())} unusable>"

    def rows(self, which: Any) -> Computed:
        """Some of the rows, chosen by a mask, a slice or indices."""
        same = self.by_motion is self.by_position_pa
        names = [field.name for field in fields(self) if not (same and field.name == "by_motion")]
        columns = {name: getattr(self, name)[which] for name in names}
        return Computed(**{"by_motion": columns["by_position_pa"], **columns})

    @property
    def usable(self) -> NDArray[np.bool_]:
        """Whether the model holds for an observation, shape (n,)."""
        return np.asarray(~self.status.any(axis=-1))


class Prediction(Protocol):
    """The observations of an arc predicted for some motions: the values at once, all else for the rows asked for."""

    @property
    def value_m(self) -> Floats:
        """Range, delay or range difference over the count interval of every observation, m, shape (n,)."""
        ...

    def rows(self, which: Any) -> Computed:
        """Values and partials of the rows chosen by a mask, a slice or indices, in that order."""
        ...


class Predictor(ABC):
    """The observations of one arc, prepared for predictions by any motions of the targets near approximate ones.

    Attributes
    ----------
    model : PhysicalModel
        What the predictions rest on.
    observations : Observations
        What is predicted.
    motions : tuple of TargetMotion
        Motions of the targets that the arc was prepared at.
    targets : tuple of str
        Names of the targets, in the order of the motions; empty where there is only one.
    target : ndarray of int32, shape (n,)
        Index of each observation's target among the motions; -1 of a source at infinity.
    stations : tuple of str
        Names of the stations that take part, each once.
    transmitters, receivers : ndarray of int32, shape (n,)
        Index into ``stations`` of each observation's first and second station; without a first one it is the second.
    more_partials : bool
        Whether partials by the stations' places and by the electron content above them are computed.
    """

    def __init__(
        self,
        model: PhysicalModel,
        observations: Observations,
        motions: GivenMotions,
        targets: Sequence[str] = (),
        more_partials: bool = False,
    ) -> None:
        self.model, self.targets, self.more_partials = model, tuple(targets), more_partials
        self.motions = as_motions(motions, model, self.targets)
        self._take(observations)

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {len(self.observations)} observations by {', '.join(self.stations)}>"

    def _take(self, observations: Observations) -> None:
        """Find the stations and targets of observations, in the order of their links."""
        self.observations = observations
        found: dict[str, Station] = {}
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
                found.setdefault(station.name, station)
                ends[i, end] = list(found).index(station.name)
            source = self.model.sources.get(canonical_target(link.target))
            if source is not None:
                if not link.differenced:
                    raise InputError(
                        f"{origin}: {link.path}: {link.target} is a source at infinity, of which there are VLBI "
                        "delays only"
                    )
                ends[i, 2], directions[i] = -1, source
            elif self.targets:
                if canonical_target(link.target) not in position:
                    raise InputError(
                        f"{origin}: target {link.target!r} has no position; there are {', '.join(self.targets)}"
                    )
                ends[i, 2] = position[canonical_target(link.target)]
        self.stations, self._stations = tuple(found), tuple(found.values())
        self.transmitters, self.receivers, self.target = (column[observations.link] for column in ends.T)
        self._directions = directions  # of sources at infinity, by link

    @property
    def simple(self) -> Predictor:
        """The predictor of the simple observations that the tracking consists of."""
        return self

    @property
    @abstractmethod
    def predicted_eop(self) -> NDArray[np.bool_]:
        """Whether an observation rests on predicted Earth orientation, shape (n,)."""

    @property
    def trajectories(self) -> tuple[AnyTrajectory, ...]:
        """Trajectories of the targets that are spacecraft."""
        return tuple(motion.trajectory for motion in self.motions if motion.trajectory is not None)

    def _given(self, motions: GivenMotions | None) -> Motions:
        """Return the given motions, by default those that the arc was prepared at."""
        return self.motions if motions is None else as_motions(motions, self.model, self.targets)

    @abstractmethod
    def at(self, motions: GivenMotions | None = None) -> Prediction:
        """Predict all values at once, partials of the rows that are asked for.

        Parameters
        ----------
        motions : TargetMotion, LunarPosition or trajectory, or a sequence of them
            Motions of the targets in their order, near those that the arc was prepared at, which are the default.
        """

    @abstractmethod
    def select(self, which: Any) -> Predictor:
        """The arc of some of the observations (a mask, a slice or indices), already prepared.

        Preparing is nearly all the work of an arc: shorter arcs of the same observations are best parts of the longest.
        """

    def with_motions(self, motions: GivenMotions) -> Self:
        """Return the arc with other motions in place of those that it was prepared at, near them."""
        other = copy.copy(self)
        other.motions = self._given(motions)
        return other

    @abstractmethod
    def with_model(self, model: PhysicalModel, motions: GivenMotions | None = None) -> Predictor:
        """The same observations prepared with another model, for values only."""

    def compute(self, motions: GivenMotions | None = None) -> Computed:
        """Predict all observations, with partials; the argument is that of :meth:`at`."""
        return self.at(motions).rows(slice(None))

    @accepts_quantities
    def with_values(self, value_m: Floats) -> Self:
        """The same arc with other measured values, shape (n,), m; nothing is prepared again."""
        other = copy.copy(self)
        other.observations = replace(self.observations, value_m=value_m)
        return other

    def terms(self, motions: GivenMotions | None = None) -> dict[str, Floats]:
        """Table of terms: by how much each active term changes each computed value, m, shape (n,).

        Computed with everything minus computed without that term, in the order of
        :data:`~radioloc.measurements.terms.TERMS`.
        """
        given = self._given(motions)
        full_m = self.at(given).value_m
        skip = () if any(motion.trajectory is None for motion in given) else _LANDER_TERMS
        table = {}
        for name in TERMS:
            if self.model.has(name) and name not in skip:
                without = self.with_model(self.model.without(name), given)
                table[name] = full_m - without.at(given).value_m
        return table


def reasons(
    predictor: Predictor, computed: Computed, which: Any = slice(None)
) -> tuple[NDArray[np.int8], NDArray[np.str_]]:
    """Return the first status of each predicted row that is not OK, and the same in words, shapes (n,)."""
    # `computed` are predictions of the rows `which`; texts are empty where the observation is usable.
    ends = np.stack([predictor.transmitters[which], predictor.receivers[which]], axis=-1)
    return describe(computed.status, computed.elevation_rad, predictor.stations, ends)


def blocks(predictor: Predictor) -> Iterator[NDArray[np.intp]]:
    """Rows of a predictor, some ten thousand at a time."""
    n = len(predictor.observations)
    for start in range(0, n, ROWS_AT_ONCE):
        yield np.arange(start, min(start + ROWS_AT_ONCE, n))
