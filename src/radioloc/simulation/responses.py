"""What small departures of the world from the model do to the observations, to first order.

A Monte Carlo study draws departures anew in every trial. Computing each world anew takes seconds; the sum of responses,
each times what was drawn, takes microseconds. A station that stands elsewhere, an Earth that is turned, a Moon that is
moved: all are displacements of one end of a light path, along which its length changes. Effects of second order, and of
the light time on where the ends are (1e-4 of the response), are left out.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from radioloc.constants import C_M_S, EARTH_ROTATION_RAD_S
from radioloc.earth.geodesy import rot_itrf_to_enu
from radioloc.errors import InputError
from radioloc.lunar import cartesian_to_selenographic, east_north_up, rot_icrf_to_pa, rot_pa_to_me
from radioloc.measurements.exact_predictor import Computed
from radioloc.measurements.observations import RANGE, Observations
from radioloc.measurements.physical_model import PhysicalModel
from radioloc.measurements.registry import is_differenced, is_integrated
from radioloc.simulation.departures import POSITION, Departure
from radioloc.simulation.media import media_partials, refuse_unknown_frequencies
from radioloc.simulation.truth import Clock, Truth
from radioloc.simulation.visibility import directions_itrf
from radioloc.time import tt_to_tdb, utc_to_tai, utc_to_tt

_CLOCK_S, _CLOCK_RATE = 1e-3, 1e-9
"""Departures of clocks that responses are taken from: large beside the rounding of epochs, and clocks are linear."""


def responses(
    model: PhysicalModel,
    observations: Observations,
    target_pa_m: NDArray[np.float64],
    computed: Computed,
    departures: Sequence[Departure],
    *,
    truth: Truth,
    clock_epoch_utc: str | None = None,
) -> NDArray[np.float64]:
    """Partial derivatives of the observed values by departures, shape (departures, n).

    Parameters
    ----------
    model : PhysicalModel
        The nominal model.
    observations : Observations
    target_pa_m : ndarray, shape (3,)
        Where the point stands, principal axes, m.
    computed : Computed
        Prediction of the observations there.
    departures : sequence of Departure
    truth : Truth
        Its mappings of media, and the epochs of its clocks.
    clock_epoch_utc : str, optional
        When offsets hold of clocks that have no epoch in the truth.

    Raises
    ------
    InputError
        A content of electrons departs, but frequencies are not known; or a departure is not known.
    StationError
        A station is not in the catalogue.
    """
    ends = _Ends(model, observations, target_pa_m, computed)
    light_time_s = np.where(observations.kind == RANGE, computed.value_m / C_M_S, 0.0)
    media = None
    rows = []
    for departure in departures:
        name, station, axis = departure.quantity, departure.station, departure.axis or 0
        if name in ("zenith_delay_m", "tec_tecu"):
            if media is None:
                mappings = truth.troposphere_mapping, truth.ionosphere_mapping
                media = media_partials(model, observations, target_pa_m, *mappings)
            row = media[name == "tec_tecu"].get(station, np.zeros(len(observations)))
            refuse_unknown_frequencies(row)
        elif name == "range_bias_m":
            one = Truth(range_bias_m={station: 1.0})
            row = one.added_m(model, observations, target_pa_m, light_time_s)["range_bias"]
        elif name in ("clock_s", "clock_rate"):
            known = truth.clock.get(station, Clock())
            epoch = known.epoch_utc or clock_epoch_utc
            size = _CLOCK_S if name == "clock_s" else _CLOCK_RATE
            clock = Clock(size) if name == "clock_s" else Clock(0.0, size, epoch)
            one = Truth(clock={station: clock})
            tags = utc_to_tai(one.true_epochs(observations, model.catalogue))
            late_s = tags.seconds_since(utc_to_tai(observations.epoch))
            added_m = one.added_m(model, observations, target_pa_m, light_time_s)["clock"]
            row = (added_m + computed.by_time_m_s * late_s) / size
        elif name == POSITION:
            row = computed.by_position_pa @ ends.enu_pa[axis]
        elif name == "moon_m":
            row = ends.by_moon(axis)
        elif name == "libration_rad":
            row = computed.by_position_pa @ np.cross(np.eye(3)[axis], target_pa_m)
        elif name == "station_enu_m":
            found = model.catalogue.get(station)
            shift = {found.name: rot_itrf_to_enu(found.itrf_m)[axis]}
            row = ends.by_stations(shift)
        elif name == "ut1_s":
            row = ends.by_stations(
                {s: EARTH_ROTATION_RAD_S * np.array([-r[1], r[0], 0.0]) for s, r in ends.itrf_m.items()}
            )
        elif name == "pole_rad":
            # W = R3(-s') R2(xp) R1(yp), IERS Conventions 2010, equation 5.3.
            shifts = {s: ((-r[2], 0.0, r[0]), (0.0, r[2], -r[1]))[axis] for s, r in ends.itrf_m.items()}
            row = ends.by_stations({s: np.array(shift) for s, shift in shifts.items()})
        else:
            raise InputError(f"a departure of {name!r} is not known")
        rows.append(row)
    return np.array(rows).reshape(len(rows), len(observations))


class _Ends:
    """Where both ends of each light path are and which way the path leads; computed when first asked for."""

    def __init__(
        self,
        model: PhysicalModel,
        observations: Observations,
        target_pa_m: NDArray[np.float64],
        computed: Computed,
    ) -> None:
        self._model, self._observations, self._computed = model, observations, computed
        self._target_pa_m = target_pa_m
        names = sorted({name for link in observations.links for name in (link.transmitter, link.receiver)})
        self.itrf_m = {station.name: station.itrf_m for station in map(model.catalogue.get, names)}
        rot = rot_pa_to_me(model.ephemeris.constants)
        longitude_rad, latitude_rad, _ = cartesian_to_selenographic(rot @ target_pa_m)
        self.enu_pa = east_north_up(longitude_rad, latitude_rad) @ rot
        self._away: list[tuple[float, NDArray[np.float64]]] = []
        self._moon_axes_pa: NDArray[np.float64] | None = None

    def by_stations(self, shifts_m: dict[str, NDArray[np.float64]]) -> NDArray[np.float64]:
        """Change of each value with displacements of stations, ITRF, m."""
        observations = self._observations
        names = list(self.itrf_m)
        if not self._away:
            tt = utc_to_tt(observations.epoch)
            counted = is_integrated(observations.kind)
            half_s = np.where(counted, 0.5 * observations.count_s, 0.0)
            self._away = [(1.0, directions_itrf(self._model, self._target_pa_m, names, tt.shifted(half_s)))]
            if counted.any():
                early = directions_itrf(self._model, self._target_pa_m, names, tt.shifted(-half_s))
                self._away.append((-1.0, early * counted[:, None, None]))
        catalogue = self._model.catalogue
        ends = np.array(
            [
                [names.index(catalogue.get(name).name) for name in (link.transmitter, link.receiver)]
                for link in observations.links
            ]
        )[observations.link]
        first = np.where(is_differenced(observations.kind), -1.0, 1.0)
        out = np.zeros(len(observations))
        for k, name in enumerate(names):
            if name in shifts_m:
                # A station that moves towards the target makes its leg shorter.
                taking_part = first * (ends[:, 0] == k) + (ends[:, 1] == k)
                for sign, away in self._away:
                    out -= sign * taking_part * (away[:, k] @ shifts_m[name])
        return out

    def by_moon(self, axis: int) -> NDArray[np.float64]:
        """Change of each value with the Moon moved away from the Earth, along its orbit or normal to it."""
        if self._moon_axes_pa is None:
            tdb = tt_to_tdb(utc_to_tt(self._observations.epoch))
            position_m, velocity_m_s = self._model.ephemeris.geocentric("moon", tdb)
            radial = position_m / np.linalg.norm(position_m, axis=-1)[:, None]
            normal = np.cross(position_m, velocity_m_s)
            normal = normal / np.linalg.norm(normal, axis=-1)[:, None]
            axes = np.stack([radial, np.cross(normal, radial), normal], axis=1)
            to_pa = rot_icrf_to_pa(self._model.libration.angles(tdb)[0])
            self._moon_axes_pa = np.einsum("nij,nkj->nki", to_pa, axes)
        return np.einsum("ni,ni->n", self._computed.by_position_pa, self._moon_axes_pa[:, axis])
