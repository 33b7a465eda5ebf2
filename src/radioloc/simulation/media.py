"""What is left of the troposphere's and the ionosphere's delay when the model of them is a little wrong."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from radioloc.constants import C_M_S
from radioloc.errors import InputError
from radioloc.measurements.observations import Observations, is_counted, is_differenced
from radioloc.measurements.physical_model import PhysicalModel
from radioloc.simulation.visibility import Target, elevations
from radioloc.time import utc_to_tt

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
    by_zenith, by_tec = media_partials(
        model, observations, target_pa_m, troposphere_mapping, ionosphere_mapping
    )
    added = {}
    for name, errors, partials in (("troposphere", zenith_m, by_zenith), ("ionosphere", tec_tecu, by_tec)):
        added[name] = np.zeros(len(observations))
        for station, error in errors.items():
            if error and station in partials:
                added[name] += error * partials[station]
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
    ends = ("transmitter", "receiver")
    n = len(observations)
    names = sorted({getattr(link, end) for link in observations.links for end in ends})
    place = {name: k for k, name in enumerate(names)}
    by_zenith, by_tec = np.zeros((n, len(names))), np.zeros((n, len(names)))
    counted, delay = is_counted(observations.kind), is_differenced(observations.kind)
    down_hz = C_M_S / (observations.wavelength_um * 1e-6)
    half_s = np.where(counted, 0.5 * observations.count_s, 0.0)
    tt = utc_to_tt(observations.epoch)
    # Of the two instants, that of a range or a delay is the first; the second one is for what is counted alone.
    for sign, rows, shift_s in (
        (1.0, np.arange(n), half_s),
        (-1.0, np.flatnonzero(counted), -half_s),
    ):
        at = elevations(model, target_pa_m, names, tt[rows].shifted(shift_s[rows])).at_station_rad
        for end in ends:
            which = np.array([place[getattr(link, end)] for link in observations.links])[
                observations.link[rows]
            ]
            elevation_rad = at[np.arange(len(rows)), which]
            leg = np.where(delay[rows] & (end == "transmitter"), -sign, sign)
            sent = (end == "transmitter") & ~delay[rows]
            hz = np.where(sent, observations.uplink_hz[rows], down_hz[rows])
            phase = np.where(counted[rows], -1.0, 1.0)
            at_frequency = _IONOSPHERE_M_HZ2 * ionosphere_mapping(elevation_rad) / hz**2
            by_zenith[rows, which] += leg * troposphere_mapping(elevation_rad)
            by_tec[rows, which] += leg * phase * at_frequency
    return dict(zip(names, by_zenith.T, strict=True)), dict(zip(names, by_tec.T, strict=True))
