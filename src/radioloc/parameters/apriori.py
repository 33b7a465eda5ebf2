"""A-priori sigmas of parameters that are considered by default, by the stated quality of what their values come from.

Functions of observations and members (names with indices, as :mod:`~radioloc.parameters.columns` has them) that give
sigmas by member, or why there are none, in words. Members that are not in the result are not considered.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from radioloc.earth.eop_prediction import orientation_errors
from radioloc.media.csp import CHARGED, WET
from radioloc.media.ionosphere import UniformTec
from radioloc.parameters.kind import Amount
from radioloc.parameters.rows import ObservationRows

Sigmas = dict[str, Amount]
Members = Mapping[str, int]

_MJD_2000, _DAYS_PER_YEAR = 51544.5, 365.25


def station_positions(rows: ObservationRows, members: Members) -> Sigmas:
    """By what the catalogue states of each station, or its quality."""
    return {name: rows.model.catalogue.get(name).position_sigma_m for name in members}


def clocks(rows: ObservationRows, members: Members) -> Sigmas:
    """Quasars leave 0.2 ns of the clocks in VLBI delays; stations that range are synchronized to 10 ns."""
    by_quasars = np.unique(rows.ends[rows.baseline & ~rows.integrated])
    return {name: 0.2e-9 if k in by_quasars else 10e-9 for name, k in members.items()}


def clock_rates(rows: ObservationRows, members: Members) -> Sigmas:
    """What quasars leave of hydrogen masers in VLBI delays; in counted observations they are offsets of frequency."""
    by_quasars = np.unique(rows.ends[rows.baseline & ~rows.integrated])
    return {name: 5e-15 for name, k in members.items() if k in by_quasars}


def frequency_offsets(rows: ObservationRows, members: Members) -> Sigmas:
    """Of two masers, and what quasars leave in delay rates; two-way there is none, one-way it is to be estimated."""
    link, three_way = rows.observations.link, ~rows.baseline & ~rows.two_way & ~rows.one_way
    sigmas: Sigmas = {}
    for of, sigma in ((rows.baseline, 1e-14), (three_way, 1e-13)):
        found = np.unique(link[of & rows.integrated])
        sigmas |= {name: sigma for name, k in members.items() if k in found}
    return sigmas


def zenith_delays(rows: ObservationRows, members: Members) -> Sigmas:
    """Of radio: standard atmosphere and GPT3 know no weather, of which VMF3 and calibrations of the DSN leave 1 cm."""
    files, calibrations = rows.model.radio_atmosphere, rows.model.media_calibrations
    sigmas: Sigmas = {}
    for name in _of_radio(rows, members):
        station = rows.model.catalogue.get(name)
        calibrated = calibrations is not None and calibrations.serves(station, WET)
        known = calibrated or (files is not None and files.source_of(station) == "VMF3")
        sigmas[name] = 0.01 if known else 0.03
    return sigmas


def electron_contents(rows: ObservationRows, members: Members) -> Sigmas | str:
    """What maps and calibrations leave; one content for everywhere, or none, leaves more.

    Where the ionosphere is switched off, the observations are taken to be free of it, as by maps.
    """
    if np.isnan(rows.observations.wavelength_um[rows.radio]).any():
        return "the frequency of some signals is not recorded"
    model = rows.model
    sigma = 3.0
    if model.has("ionosphere") and (model.ionosphere is None or isinstance(model.ionosphere, UniformTec)):
        sigma = 20.0 if model.ionosphere is None else 10.0
    calibrations, catalogue = model.media_calibrations, model.catalogue
    return {
        name: 3.0 if calibrations is not None and calibrations.serves(catalogue.get(name), CHARGED) else sigma
        for name in _of_radio(rows, members)
    }


def _of_radio(rows: ObservationRows, members: Members) -> list[str]:
    found = np.unique(rows.ends[rows.radio])
    return [name for name, k in members.items() if k in found]


def ut1(rows: ObservationRows, _: Members) -> Sigmas:
    """Measured, or predicted by lead time; the largest of the arc."""
    return {"": float(_orientation_errors(rows)[0].max())}


def pole(rows: ObservationRows, _: Members) -> Sigmas:
    """Measured, or predicted by lead time; the largest of the arc."""
    return {"": float(_orientation_errors(rows)[1].max())}


def _orientation_errors(rows: ObservationRows) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    last = rows.observations.epoch.mjd.max(keepdims=True)
    return orientation_errors(rows.model.earth.table, last)


def moon_position(rows: ObservationRows, _: Members) -> Sigmas:
    """By ephemeris; one that is not known counts as DE421.

    DE421, of data until 2007, less DE440 from 1992 to 2050: 0.3 m (rms) away from the Earth, 0.4 m normal to the orbit,
    and along it 0.8 m and what grows with the square of time, 1.2 m in 2005 to 2010, 2.8 m in 2019 to 2025. DE440 is
    tied to the ICRF to 0.2 mas (Park et al. 2021), 0.4 m at the Moon, and by ranges to the reflectors to decimetres.
    """
    if rows.model.ephemeris.name == "DE440":
        return {"": (0.1, 0.4, 0.4)}
    return {"": (0.3, 0.8 + 0.0042 * _years(rows) ** 2, 0.4)}


def moon_position_variation(rows: ObservationRows, _: Members) -> Sigmas:
    """What comes and goes with the month in DE421 less DE440; half of it for DE440, which has 13 years of data more.

    About the mean of some years, rms: away from the Earth 0.03 m until 2008, 0.07 m in 2010 to 2020, 0.14 m in 2020 to
    2030, 0.29 m in 2030 to 2049; along the orbit 0.1 m besides its trend; normal to it 0.4 m.
    """
    half = 0.5 if rows.model.ephemeris.name == "DE440" else 1.0
    return {"": (half * (0.03 + 0.00016 * _years(rows) ** 2), half * 0.1, half * 0.4)}


def _years(rows: ObservationRows) -> float:
    """Of the last observation, since 2000."""
    return (float(rows.observations.epoch.mjd.max()) - _MJD_2000) / _DAYS_PER_YEAR


def libration(rows: ObservationRows, _: Members) -> Sigmas:
    """DE421 less DE440 in mean-Earth axes, rms from 1992 to 2050; of DE440 what varies in that."""
    newer = rows.model.ephemeris.name == "DE440"
    return {"": (5e-8, 5e-8, 5e-8) if newer else (0.9e-7, 1.5e-7, 0.7e-7)}


def libration_variation(rows: ObservationRows, _: Members) -> Sigmas:
    """DE421 less DE440 about its mean from 2006 to 2024, 0.07, 0.07, 0.11 m rms on the ground; half of it for DE440."""
    half = 0.5 if rows.model.ephemeris.name == "DE440" else 1.0
    return {"": (half * 4e-8, half * 4e-8, half * 6e-8)}
