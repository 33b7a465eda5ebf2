"""Corrections to stations, Earth orientation and the media above stations.

Station coordinates (m), UT1 (s) and the pole (rad); zenith delay of the troposphere (m) and vertical electron content
(TECU).
"""

from __future__ import annotations

import numpy as np

from radioloc.constants import EARTH_ROTATION_RAD_S
from radioloc.earth.eop_prediction import orientation_errors
from radioloc.earth.geodesy import rot_itrf_to_enu
from radioloc.errors import InputError
from radioloc.media.csp import CHARGED, WET
from radioloc.media.ionosphere import UniformTec
from radioloc.parameters.kind import Members, ParameterKind, Scope, Sigmas, all_observations, both_stations
from radioloc.parameters.rows import ObservationRows
from radioloc.vectors import Floats


def _itrf_m(rows: ObservationRows) -> Floats:
    """ITRF coordinates of the observing stations, m, shape (n_stations, 3)."""
    return np.array([rows.model.catalogue.get(name).itrf_m for name in rows.predictor.stations])


def _station_position(rows: ObservationRows) -> Floats:
    to_enu = np.array([rot_itrf_to_enu(itrf_m) for itrf_m in _itrf_m(rows)])
    return _displaced(rows, np.swapaxes(to_enu, 1, 2)) * (rows.ends >= 0)[..., None]


def _displaced(rows: ObservationRows, shifts: Floats) -> Floats:
    """Return partials with respect to station displacements, ITRF, m per unit, shape (n_stations, 3, components)."""
    # One component after the other in memory, (3, components, ends, m)
    by_station = rows.computed.by_station_itrf.T
    shift = np.take(shifts.transpose(1, 2, 0), rows.ends.T, axis=-1)
    return np.asarray(sum(by_station[i] * shift[i] for i in range(3)).T)


def _rotated(rows: ObservationRows, axes: list[list[float]]) -> Floats:
    """Return partials with respect to rotations of the Earth about axes, ITRF, rad per unit, shape (components, 3)."""
    return _displaced(rows, np.swapaxes(np.cross(axes, _itrf_m(rows)[:, None]), 1, 2))


def _electron_content(rows: ObservationRows) -> Floats:
    by_content = rows.computed.by_electron_content_m
    if np.isnan(by_content).any():
        row = int(rows.rows[np.flatnonzero(np.isnan(by_content).any(axis=-1))[0]])
        raise InputError(
            f"{rows.observations.origin(row)}: electron_content needs the frequency of the signal, which is not "
            "recorded; give uplink_hz and wavelength_um"
        )
    return (by_content * (rows.ends >= 0))[..., None]


def _orientation_sigmas(rows: ObservationRows) -> tuple[Floats, Floats]:
    """Return errors of UT1, s, and of the pole, rad, at the end of the arc, where they are largest."""
    last = rows.observations.epoch.mjd.max(keepdims=True)
    return orientation_errors(rows.model.earth.table, last)


def _delay_sigmas(rows: ObservationRows, members: Members) -> Sigmas:
    """Return 3 cm for a standard atmosphere or GPT3, which have no weather, and 1 cm for VMF3 and DSN calibrations."""
    files, calibrations = rows.model.radio_atmosphere, rows.model.media_calibrations
    sigmas: Sigmas = {}
    for name in _radio_stations(rows, members):
        station = rows.model.catalogue.get(name)
        calibrated = calibrations is not None and calibrations.has_cards(station, WET)
        has_weather = calibrated or (files is not None and files.source_of(station) == "VMF3")
        sigmas[name] = 0.01 if has_weather else 0.03
    return sigmas


def _content_sigmas(rows: ObservationRows, members: Members) -> Sigmas | str:
    """Return the error of maps and calibrations, which is larger for a uniform content or none."""
    # Without the term of the ionosphere, the observations count as corrected by maps.
    if np.isnan(rows.observations.wavelength_um[rows.radio]).any():
        return "the frequency of some signals is not recorded"
    model = rows.model
    sigma = 3.0
    if model.has("ionosphere") and (model.ionosphere is None or isinstance(model.ionosphere, UniformTec)):
        sigma = 20.0 if model.ionosphere is None else 10.0
    calibrations, catalogue = model.media_calibrations, model.catalogue
    return {
        name: 3.0
        if calibrations is not None and calibrations.has_cards(catalogue.get(name), CHARGED)
        else sigma
        for name in _radio_stations(rows, members)
    }


def _radio_stations(rows: ObservationRows, members: Members) -> list[str]:
    radio = np.unique(rows.ends[rows.radio])
    return [name for name, k in members.items() if k in radio]


STATION_POSITION = ParameterKind(
    name="station_position",
    unit="m",
    description="correction to a station's catalogue coordinates: east, north, up",
    scopes=(Scope.STATION,),
    partials=_station_position,
    acts_on=both_stations,
    components=("east", "north", "up"),
    label="position",
    more_partials=True,
    considered=lambda rows, names: {n: rows.model.catalogue.get(n).position_sigma_m for n in names},
)
UT1 = ParameterKind(
    name="ut1",
    label="UT1",
    unit="s",
    description="correction to the tabulated UT1",
    scopes=(Scope.EARTH, Scope.SESSION),
    partials=lambda rows: _rotated(rows, [[0.0, 0.0, EARTH_ROTATION_RAD_S]]),
    acts_on=all_observations,
    scale=2e-3,
    more_partials=True,
    considered=lambda rows, _: {"": float(_orientation_sigmas(rows)[0].max())},
)
POLE = ParameterKind(
    name="pole",
    unit="rad",
    description="correction to the tabulated pole coordinates xp and yp",
    scopes=(Scope.EARTH, Scope.SESSION),
    # W = R3(-s') R2(xp) R1(yp), IERS Conventions 2010, equation 5.3.
    partials=lambda rows: _rotated(rows, [[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0]]),
    acts_on=all_observations,
    components=("x", "y"),
    label="coordinate of the pole",
    scale=1.6e-7,
    more_partials=True,
    considered=lambda rows, _: {"": float(_orientation_sigmas(rows)[1].max())},
)
ZENITH_DELAY = ParameterKind(
    name="zenith_delay",
    unit="m",
    description="wet zenith delay of radio signals above a station, beyond the model's",
    scopes=(Scope.STATION, Scope.PASS),
    partials=lambda rows: (rows.computed.by_zenith_wet * (rows.ends >= 0))[..., None],
    acts_on=both_stations,
    scale=0.3,
    term="troposphere",
    considered=_delay_sigmas,
    considered_per=Scope.PASS,
)
ELECTRON_CONTENT = ParameterKind(
    name="electron_content",
    unit="tecu",
    description="vertical electron content above a station, beyond the model's, 1e16 per square metre",
    scopes=(Scope.STATION, Scope.PASS),
    partials=_electron_content,
    acts_on=both_stations,
    scale=10.0,
    more_partials=True,
    considered=_content_sigmas,
    considered_per=Scope.PASS,
)
