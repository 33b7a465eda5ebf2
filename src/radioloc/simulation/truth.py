"""What the world of a simulation has that the model used to fit it has not.

A truth is a list of departures from a nominal model, real minus modelled. Those of places and orientations make another
:class:`~radioloc.measurements.physical_model.PhysicalModel` (:meth:`Truth.model`); those of instruments and air are
added to the observations by name (:meth:`Truth.added_m`).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from radioloc.constants import C_M_S
from radioloc.earth.eop import EopTable
from radioloc.earth.geodesy import rot_itrf_to_enu
from radioloc.earth.orientation import EarthOrientation
from radioloc.earth.stations import StationCatalogue
from radioloc.errors import InputError
from radioloc.measurements.measurement_type import TIME_TAGS
from radioloc.measurements.observations import RANGE, Observations
from radioloc.measurements.physical_model import PhysicalModel
from radioloc.measurements.registry import is_differenced, is_integrated
from radioloc.measurements.terms import active_terms
from radioloc.simulation.media import MappingFunction, black_eisner, media_error_m, thin_shell
from radioloc.simulation.model_errors import ModelErrors
from radioloc.simulation.offset_moon import OffsetEphemeris, OffsetOrientation
from radioloc.simulation.visibility import Target
from radioloc.time import Epochs, epochs_from_strings, tai_to_utc, utc_to_tai

_Value = TypeVar("_Value")


@dataclass(frozen=True, slots=True)
class Clock:
    """Error of a station's clock.

    Parameters
    ----------
    offset_s : float
        What it reads minus what it should, s.
    rate : float
        Growth of that, s/s.
    epoch_utc : str, optional
        When the offset holds; needed with a rate.

    Raises
    ------
    InputError
        A rate without an epoch, or the offset is longer than a second.
    """

    offset_s: float = 0.0
    rate: float = 0.0
    epoch_utc: str | None = None

    def __post_init__(self) -> None:
        if not (abs(self.offset_s) < 1.0 and abs(self.rate) < 1e-6):
            raise InputError(
                f"a clock {self.offset_s!r} s and {self.rate!r} s/s off is not one that tracks; below 1 s and 1e-6"
            )
        if self.rate and self.epoch_utc is None:
            raise InputError("a clock's rate needs the epoch_utc at which its offset holds")

    def error_s(self, tai: Epochs) -> NDArray[np.float64]:
        """Reading minus right time, s, shape (n,)."""
        if self.epoch_utc is None:
            return np.full(len(tai), self.offset_s)
        origin = utc_to_tai(epochs_from_strings([self.epoch_utc], "UTC"))
        since_s = tai.seconds_since(origin[np.zeros(len(tai), dtype=np.int64)])
        return self.offset_s + self.rate * since_s


@dataclass(frozen=True, slots=True, kw_only=True)
class Truth(ModelErrors):
    """Departures of the simulated world from the nominal model.

    Parameters
    ----------
    moon_m, libration_rad, station_enu_m, ut1_s, pole_rad, range_bias_m, zenith_delay_m, tec_tecu
        As in :class:`~radioloc.simulation.model_errors.ModelErrors`.
    clock : mapping of str to Clock
        Stations' clocks. A clock that is ahead tags observations late and makes the arrivals that it times late.
    terms_on, terms_off : collection of str
        Terms (:data:`radioloc.measurements.terms.TERMS`) that the world has and the model not, and the reverse.
    troposphere_mapping, ionosphere_mapping : callable
        From elevation (rad) to the two delays over those in the zenith.

    Notes
    -----
    Names of stations are those of the catalogue or aliases.
    """

    clock: Mapping[str, Clock] = field(default_factory=dict)
    terms_on: Iterable[str] = ()
    terms_off: Iterable[str] = ()
    troposphere_mapping: MappingFunction = black_eisner
    ionosphere_mapping: MappingFunction = thin_shell

    def __post_init__(self) -> None:
        for name in ("terms_on", "terms_off"):
            object.__setattr__(self, name, tuple(getattr(self, name)))

    def model(self, nominal: PhysicalModel) -> PhysicalModel:
        """The physical model of the simulated world.

        Parameters
        ----------
        nominal : PhysicalModel
            What the observations will be fitted with.

        Raises
        ------
        InputError
            A term is not known.
        StationError
            A station is not in the catalogue.
        """
        active_terms((*self.terms_on, *self.terms_off))
        terms = (nominal.terms | set(self.terms_on)) - set(self.terms_off)
        ephemeris, libration = nominal.ephemeris, nominal.libration
        if any(self.moon_m):
            ephemeris = OffsetEphemeris.of(ephemeris, self.moon_m)
        if any(self.libration_rad):
            libration = OffsetOrientation.of(libration, self.libration_rad)
        return replace(
            nominal,
            ephemeris=ephemeris,
            libration=libration,
            earth=self._earth(nominal.earth, "subdaily_eop" in terms),
            catalogue=self._catalogue(nominal.catalogue),
            terms=frozenset(terms),
        )

    def true_epochs(self, observations: Observations, catalogue: StationCatalogue) -> Epochs:
        """When the tagged events happened; the tags are what the stations' clocks read then, UTC.

        Raises
        ------
        StationError
            A station is not in the catalogue.
        """
        if not self.clock:
            return observations.epoch
        tai = utc_to_tai(observations.epoch)
        first_s, second_s = self._clock_errors_s(observations, catalogue, tai, tai)
        transmit, receive = (TIME_TAGS.index(name) for name in ("transmit", "receive"))
        by_first = is_differenced(observations.kind) | (observations.tag == transmit)
        error_s = np.where(by_first, first_s, np.where(observations.tag == receive, second_s, 0.0))
        moved = tai_to_utc(tai.shifted(-error_s))
        # Clocks that are right leave the tag as it was, to the last bit.
        return Epochs(
            np.where(error_s == 0.0, observations.epoch.jd, moved.jd),
            np.where(error_s == 0.0, observations.epoch.fraction, moved.fraction),
            "UTC",
        )

    def added_m(
        self,
        world: PhysicalModel,
        observations: Observations,
        target_pa_m: Target,
        light_time_s: NDArray[np.float64],
    ) -> dict[str, NDArray[np.float64]]:
        """What clocks, biases and media add to each observation, by name, m.

        Parameters
        ----------
        world : PhysicalModel
            From :meth:`model`.
        observations : Observations
        target_pa_m : ndarray, shape (3,), or Trajectory
            Principal axes, m, or a spacecraft.
        light_time_s : ndarray, shape (n,)
            From the first sending to the last reception; used for ranges.

        Returns
        -------
        dict of str to ndarray, shape (n,)
            ``clock`` (beyond the tag's shift), ``range_bias``, ``troposphere``, ``ionosphere``; those that are given.

        Raises
        ------
        StationError
            A station is not in the catalogue.
        InputError
            As :func:`radioloc.simulation.media.media_error_m`.
        """
        catalogue = world.catalogue
        added: dict[str, NDArray[np.float64]] = {}
        if self.clock:
            added["clock"] = self._clock_m(observations, catalogue, light_time_s)
        if self.range_bias_m:
            by_name = _canonical(self.range_bias_m, catalogue)
            bias_m = np.array([by_name.get(link.receiver, 0.0) for link in observations.links])
            added["range_bias"] = np.where(observations.kind == RANGE, bias_m[observations.link], 0.0)
        if self.zenith_delay_m or self.tec_tecu:
            media = media_error_m(
                world,
                observations,
                target_pa_m,
                _canonical(self.zenith_delay_m, catalogue),
                _canonical(self.tec_tecu, catalogue),
                self.troposphere_mapping,
                self.ionosphere_mapping,
            )
            given = (("troposphere", self.zenith_delay_m), ("ionosphere", self.tec_tecu))
            added |= {name: media[name] for name, errors in given if errors}
        return added

    def _clock_m(
        self, observations: Observations, catalogue: StationCatalogue, light_time_s: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """By how much the clocks at both ends make a time of flight or a delay longer."""
        tai = utc_to_tai(observations.epoch)
        ranges = observations.kind == RANGE
        # How much of the flight lies before the tag: all of it, none, or half.
        before = np.array([{"receive": 1.0, "transmit": 0.0, "bounce": 0.5}[name] for name in TIME_TAGS])
        before_s = np.where(ranges, light_time_s * before[observations.tag], 0.0)
        after_s = np.where(ranges, light_time_s, 0.0) - before_s
        sent, received = tai.shifted(-before_s), tai.shifted(after_s)
        first_s, second_s = self._clock_errors_s(observations, catalogue, sent, received)
        counted = is_integrated(observations.kind)
        half_s = np.where(counted, 0.5 * observations.count_s, 0.0)
        early = self._clock_errors_s(observations, catalogue, tai.shifted(-half_s), tai.shifted(-half_s))
        late = self._clock_errors_s(observations, catalogue, tai.shifted(half_s), tai.shifted(half_s))
        grown_s = (late[1] - late[0]) - (early[1] - early[0])
        return C_M_S * np.where(counted, grown_s, second_s - first_s)

    def _clock_errors_s(
        self, observations: Observations, catalogue: StationCatalogue, at_first: Epochs, at_second: Epochs
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Errors of the clocks of each observation's first and second station at given epochs, TAI."""
        clocks = _canonical(self.clock, catalogue)
        out = np.zeros((2, len(observations)))
        for i, link in enumerate(observations.links):
            rows = np.flatnonzero(observations.link == i)
            ends = (link.transmitter, at_first), (link.receiver, at_second)
            for end, (name, epochs) in enumerate(ends):
                if name in clocks and len(rows):
                    out[end, rows] = clocks[name].error_s(epochs[rows])
        return out[0], out[1]

    def _earth(self, earth: EarthOrientation, subdaily: bool) -> EarthOrientation:
        table = earth.table
        if self.ut1_s or any(self.pole_rad):
            table = EopTable(
                table.mjd_utc,
                table.xp_rad + self.pole_rad[0],
                table.yp_rad + self.pole_rad[1],
                table.ut1_minus_utc_s + self.ut1_s,
                table.dx_rad,
                table.dy_rad,
                table.predicted,
                (*table.sources, "with simulated errors"),
            )
        return EarthOrientation(
            table, subdaily_tides=subdaily, libration=subdaily, zonal_tides=earth.zonal_tides
        )

    def _catalogue(self, catalogue: StationCatalogue) -> StationCatalogue:
        for name, enu_m in self.station_enu_m.items():
            station = catalogue.get(name)
            moved_m = station.itrf_m + np.array(enu_m) @ rot_itrf_to_enu(station.itrf_m)
            catalogue = catalogue.with_station(replace(station, itrf_m=moved_m))
        return catalogue


def _canonical(by_name: Mapping[str, _Value], catalogue: StationCatalogue) -> dict[str, _Value]:
    """The same by the catalogue's names of the stations."""
    return {catalogue.get(name).name: value for name, value in by_name.items()}
