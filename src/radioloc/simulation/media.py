"""What is left of the troposphere's and the ionosphere's delay when the model of them is a little wrong."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from radioloc.constants import C_M_S
from radioloc.errors import InputError
from radioloc.measurements.observations import Observations
from radioloc.measurements.physical_model import PhysicalModel
from radioloc.measurements.registry import is_differenced, is_integrated
from radioloc.simulation.dense_visibility import station_elevations_rad
from radioloc.simulation.visibility import Target
from radioloc.time import utc_to_tt

_Share = tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.float64], NDArray[np.float64]]
"""Rows, the station that one end of their paths is at, and what a unit of zenith delay and of content there adds."""

MappingFunction = Callable[[NDArray[np.float64]], NDArray[np.float64]]
"""From elevations, rad, to the delay there over the delay in the zenith."""

_IONOSPHERE_M_HZ2 = 40.308e16
"""Delay by one TEC unit (1e16 electrons per square metre) times the square of the frequency, m Hz^2."""

_SHELL = 6371.0 / (6371.0 + 450.0)
"""Radius of the Earth over that of a thin ionosphere 450 km above it."""


def black_eisner(elevation_rad: NDArray[np.float64]) -> NDArray[np.float64]:
    """Mapping of a tropospheric delay, near 1/sin(elevation); within 1 % above 7 degrees.

    Black and Eisner (1984), Correcting satellite Doppler data for tropospheric effects, J. Geophys. Res. 89, 2616.
    """
    return np.asarray(1.001 / np.sqrt(0.002001 + np.sin(elevation_rad) ** 2))


def thin_shell(elevation_rad: NDArray[np.float64]) -> NDArray[np.float64]:
    """Mapping of an ionospheric delay by a shell at 450 km: 1/cos(zenith angle where the ray meets it)."""
    return np.asarray(1.0 / np.sqrt(1.0 - (_SHELL * np.cos(elevation_rad)) ** 2))


def media_error_m(
    model: PhysicalModel,
    observations: Observations,
    target_pa_m: Target,
    zenith_m: Mapping[str, float],
    tec_tecu: Mapping[str, float],
    troposphere_mapping: MappingFunction = black_eisner,
    ionosphere_mapping: MappingFunction = thin_shell,
) -> dict[str, NDArray[np.float64]]:
    """How much constant errors at the stations' zeniths add to observations.

    Parameters
    ----------
    model : PhysicalModel
        Gives the elevations.
    observations : Observations
        Epochs, paths and frequencies.
    target_pa_m : ndarray, shape (3,), or Trajectory
        The point on the Moon, principal axes, m.
    zenith_m : mapping of str to float
        Tropospheric delay of the zenith by station, real minus modelled, m.
    tec_tecu : mapping of str to float
        Vertical electron content by station, real minus modelled, 1e16 per square metre.
    troposphere_mapping, ionosphere_mapping : callable
        From elevation (rad) to slant over zenith.

    Returns
    -------
    dict of str to ndarray, shape (n,)
        ``troposphere`` and ``ionosphere``, m: of both legs together for a range, second minus first station for a VLBI
        delay, end minus begin of the count interval for Doppler and delay rates, whose phase the ionosphere advances as
        much as it delays a code.

    Raises
    ------
    InputError
        An electron content is given where an observation has no frequency.
    """
    stations = _stations(observations)
    shares = _shares(model, observations, target_pa_m, troposphere_mapping, ionosphere_mapping)
    zenith, tec = (np.array([errors.get(name, 0.0) for name in stations]) for errors in (zenith_m, tec_tecu))
    added = {name: np.zeros(len(observations)) for name in ("troposphere", "ionosphere")}
    for rows, station, by_zenith, by_tec in shares:
        added["troposphere"][rows] += zenith[station] * by_zenith
        # A content without an error needs no frequency.
        content = tec[station]
        added["ionosphere"][rows] += np.where(content == 0.0, 0.0, content * by_tec)
    refuse_unknown_frequencies(added["ionosphere"])
    return added


def refuse_unknown_frequencies(ionosphere_m: NDArray[np.float64]) -> None:
    """Raise :class:`InputError` where a delay of the ionosphere is not a number."""
    if np.isnan(ionosphere_m).any():
        raise InputError(
            "an error of the electron content needs the frequencies; give sessions uplink_hz, wavelength_um"
        )


def media_partials(
    model: PhysicalModel,
    observations: Observations,
    target_pa_m: Target,
    troposphere_mapping: MappingFunction = black_eisner,
    ionosphere_mapping: MappingFunction = thin_shell,
) -> tuple[dict[str, NDArray[np.float64]], dict[str, NDArray[np.float64]]]:
    """What an error of one unit at each station's zenith adds to observations.

    Parameters as :func:`media_error_m`.

    Returns
    -------
    by_zenith, by_tec : dict of str to ndarray, shape (n,)
        By station: m per metre of zenith delay, and m per TECU of vertical content, NaN where the frequency of an
        observation that the station has part in is not known.
    """
    names = _stations(observations)
    by_zenith, by_tec = np.zeros((2, len(names), len(observations)))
    for rows, station, zenith, tec in _shares(
        model, observations, target_pa_m, troposphere_mapping, ionosphere_mapping
    ):
        by_zenith[station, rows] += zenith
        by_tec[station, rows] += tec
    return dict(zip(names, by_zenith, strict=True)), dict(zip(names, by_tec, strict=True))


def _stations(observations: Observations) -> list[str]:
    return sorted({name for link in observations.links for name in (link.transmitter, link.receiver)})


def _shares(
    model: PhysicalModel,
    observations: Observations,
    target_pa_m: Target,
    troposphere_mapping: MappingFunction,
    ionosphere_mapping: MappingFunction,
) -> Iterator[_Share]:
    """What each end of the paths has part in, at each instant that counts."""
    names = _stations(observations)
    counted, delay = is_integrated(observations.kind), is_differenced(observations.kind)
    half_s = np.where(counted, 0.5 * observations.count_s, 0.0)
    tt = utc_to_tt(observations.epoch)
    # Of the two instants, that of a range or a delay is the first; the second one is for what is counted alone.
    for sign, rows, shift_s in (
        (1.0, np.arange(len(observations)), half_s),
        (-1.0, np.flatnonzero(counted), -half_s),
    ):
        at = tt[rows].shifted(shift_s[rows])
        phase = np.where(counted[rows], -1.0, 1.0)
        for end in ("transmitter", "receiver"):
            of_link = np.array([names.index(getattr(link, end)) for link in observations.links])
            station = of_link[observations.link[rows]]
            elevation_rad = station_elevations_rad(model, target_pa_m, names, station, at)
            leg, hz = np.full(len(rows), sign), C_M_S / (observations.wavelength_um[rows] * 1e-6)
            if end == "transmitter":
                leg = np.where(delay[rows], -sign, sign)
                hz = np.where(delay[rows], hz, observations.uplink_hz[rows])
            at_frequency = _IONOSPHERE_M_HZ2 * ionosphere_mapping(elevation_rad) / hz**2
            yield rows, station, leg * troposphere_mapping(elevation_rad), leg * phase * at_frequency
