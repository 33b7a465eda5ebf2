"""Air above stations, for radio signals: from weather, or from files of VMF3 (weather models) and GPT3 (climate).

What comes from where, the first that there is:

===================  ==================================================================================================
mapping functions    VMF3's coefficients; GPT3's; without files Niell's
hydrostatic, zenith  recorded pressure; VMF3; GPT3's pressure; without files the standard atmosphere's
wet, zenith          VMF3; GPT3, with recorded humidity in place of its own; without files recorded or standard
===================  ==================================================================================================

Zenith delays of the Deep Space Network's calibrations go before both at the stations that they serve.
A barometer knows the hydrostatic delay to a millimetre, better than any model (IERS Conventions 2010, section 9.1.1).
Humidity on the ground says little of that above it, so VMF3's wet delay goes before it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from radioloc.earth.geodesy import geodetic_from_itrf
from radioloc.earth.stations import Station
from radioloc.errors import CoverageError, InputError
from radioloc.media.air_files import (
    Gpt3Grid,
    Vmf3Grids,
    Vmf3Site,
    Vmf3Values,
    read_gpt3,
    read_vmf3_grids,
    read_vmf3_sites,
)
from radioloc.media.csp import DRY, WET, MediaCalibrations
from radioloc.media.mapping_functions import (
    MappingFactors,
    day_of_year,
    mapping_factors,
    niell_coefficients,
    vmf3_bc,
)
from radioloc.media.medium import LegEnd
from radioloc.media.neutral_atmosphere import (
    standard_weather,
    water_vapour_pressure_hpa,
    zenith_hydrostatic_delay_m,
    zenith_wet_delay_askne_nordius_m,
    zenith_wet_delay_m,
)
from radioloc.text_files import ANY_BYTE, read_lines
from radioloc.time import Epochs
from radioloc.vectors import Floats

_HEIGHT_M = (-500.0, 9000.0)  # heights of stations for which the models of the air hold


@dataclass(frozen=True, slots=True)
class ZenithAir:
    """Air above the station at one end of each path; rows that are not asked for are NaN."""

    hydrostatic_m: Floats  # delay at the zenith, one way, shape (n,)
    wet_m: Floats
    hydrostatic_abc: Floats  # coefficients of the mapping function, shape (n, 3)
    wet_abc: Floats
    height_above_a_m: Floats  # of the station above that for which the hydrostatic ones hold, shape (n,)

    def mapping(self, elevation_rad: Floats, rows: NDArray[np.intp] | slice) -> MappingFactors:
        """Evaluate the mapping functions of some rows at their elevations."""
        hydrostatic_abc, wet_abc = [*self.hydrostatic_abc[rows].T], [*self.wet_abc[rows].T]
        return mapping_factors(elevation_rad, self.height_above_a_m[rows], hydrostatic_abc, wet_abc)


@dataclass(frozen=True, slots=True, eq=False)
class RadioAtmosphere:
    """Files of VMF3 and GPT3: series by the station's name in the files, maps, climate for the other stations."""

    sites: dict[str, Vmf3Site]
    grids: Vmf3Grids | None
    gpt3: Gpt3Grid | None
    vmf3_files: tuple[Path, ...] = ()
    gpt3_files: tuple[Path, ...] = ()

    def source_of(self, station: Station) -> str:
        """Return ``"VMF3"`` or ``"GPT3"``, which serves a station, or refuse it."""
        if self.grids is not None or self._site(station) is not None:
            return "VMF3"
        if self.gpt3 is not None:
            return "GPT3"
        other_names = f" (nor {', '.join(station.aliases)})" if station.aliases else ""
        raise InputError(
            f"{_named(self.vmf3_files)}: there is no station {station.name}{other_names}, but "
            f"{', '.join(sorted(self.sites))}; give its files or maps too, or GPT3 for such stations ([model] gpt3), "
            "or leave out [model] vmf3"
        )

    def _site(self, station: Station) -> Vmf3Site | None:
        names = {name.upper() for name in (station.name, *station.aliases)}
        return next((site for name, site in self.sites.items() if name.upper() in names), None)

    def above(
        self, station: Station, place: tuple[float, float, float], epochs: Epochs, recorded: Floats
    ) -> tuple[Floats, ...]:
        """Air above a station as :class:`ZenithAir` has it; arguments as :func:`air_by_weather`."""
        files = self.vmf3_files if self.source_of(station) == "VMF3" else self.gpt3_files
        source = self._site(station) or self.grids or self.gpt3
        assert source is not None  # refused before
        try:
            found = source.at(epochs, *place)
        except (CoverageError, InputError) as error:
            error.args = (f"{_named(files)}, for station {station.name}: {error}",)
            raise
        latitude_rad, longitude_rad, height_m = place
        b_h, b_w, c_h, c_w = vmf3_bc(latitude_rad, longitude_rad, day_of_year(epochs))
        by_pressure_m = zenith_hydrostatic_delay_m(recorded[0], latitude_rad, height_m)
        if isinstance(found, Vmf3Values):
            hydrostatic_m, wet_m = found.zenith_hydrostatic_m, found.zenith_wet_m
            height_m = found.height_above_a_m
        else:
            hydrostatic_m = zenith_hydrostatic_delay_m(found.pressure_hpa, latitude_rad, height_m)
            vapour_hpa = water_vapour_pressure_hpa(recorded[1], recorded[2], recorded[0])
            wet_m = zenith_wet_delay_askne_nordius_m(
                np.where(np.isnan(vapour_hpa), found.vapour_pressure_hpa, vapour_hpa),
                found.mean_temperature_k,
                found.vapour_decrease_factor,
            )
        return (
            np.where(np.isnan(by_pressure_m), hydrostatic_m, by_pressure_m),
            wet_m,
            np.stack([found.hydrostatic_a, b_h, c_h], axis=-1),
            np.stack([found.wet_a, b_w, c_w], axis=-1),
            np.full(len(epochs), height_m),
        )


def air_by_weather(place: tuple[float, float, float], epochs: Epochs, recorded: Floats) -> tuple[Floats, ...]:
    """Air above a place as :class:`ZenithAir` has it, by recorded weather or else by the standard atmosphere."""
    # `place`: latitude, longitude (rad), height (m); `recorded`: pressure (hPa), temperature (K), relative humidity, or
    # NaN, shape (3, n). The wet delay needs temperature and humidity, both or neither.
    latitude_rad, _, height_m = (np.full(len(epochs), value) for value in place)
    standard = standard_weather(height_m)
    pressure_hpa = np.where(np.isnan(recorded[0]), standard[0], recorded[0])
    dry = np.isnan(recorded[1:]).any(axis=0)
    temperature_k, humidity = np.where(dry, standard[1:], recorded[1:])
    vapour_hpa = water_vapour_pressure_hpa(temperature_k, humidity, pressure_hpa)
    hydrostatic, wet = niell_coefficients(latitude_rad, day_of_year(epochs))
    return (
        zenith_hydrostatic_delay_m(pressure_hpa, latitude_rad, height_m),
        zenith_wet_delay_m(vapour_hpa, temperature_k),
        np.stack(hydrostatic, axis=-1),
        np.stack(wet, axis=-1),
        height_m,
    )


def air_above(
    end: LegEnd, files: RadioAtmosphere | None, calibrations: MediaCalibrations | None = None
) -> ZenithAir:
    """Air above the stations at one end of paths, where signals are radio."""
    n = len(end)
    air = tuple(np.full(shape, np.nan) for shape in (n, n, (n, 3), (n, 3), n))
    weather = end.weather
    recorded = np.stack([weather.pressure_hpa, weather.temperature_k, weather.relative_humidity])
    recorded = np.where(end.weather_is_here, recorded, np.nan)
    for i, station in enumerate(end.stations):
        geodetic = geodetic_from_itrf(station.itrf_m)
        place = float(geodetic.latitude_rad), float(geodetic.longitude_rad), float(geodetic.height_m)
        if not _HEIGHT_M[0] <= place[2] <= _HEIGHT_M[1]:
            raise InputError(
                f"the height of {station.name} is {place[2]:.6g} m, but the troposphere holds from "
                f"{_HEIGHT_M[0]:g} to {_HEIGHT_M[1]:g} m"
            )
        rows = np.flatnonzero(end.radio & (end.which == i))
        if not len(rows):
            continue
        here = end.epoch[rows], recorded[:, rows]
        found = air_by_weather(place, *here) if files is None else files.above(station, place, *here)
        for whole, part in zip(air, found, strict=True):
            whole[rows] = part
        if calibrations is not None:
            for phase in (False, True):
                mine = rows[end.phase[rows] == phase]
                for whole, model in ((air[0], DRY), (air[1], WET)):
                    zenith_m = calibrations.zenith_m(station, end.epoch[mine], model, phase)
                    if zenith_m is not None:
                        whole[mine] = zenith_m
    return ZenithAir(*air)


def read_radio_atmosphere(
    vmf3: Sequence[str | Path] = (), vmf3_orography: str | Path | None = None, gpt3: str | Path | None = None
) -> RadioAtmosphere:
    r"""Read files of VMF3, of sites or maps, and of GPT3.

    Parameters
    ----------
    vmf3 : sequence of path-like
        Files of sites, or maps of several epochs.
    vmf3_orography : path-like, optional
        With maps the file of their heights, ``orography_ell_1x1`` or ``orography_ell_5x5``.
    gpt3 : path-like, optional
        ``gpt3_5.grd`` or ``gpt3_1.grd``.

    Raises
    ------
    FileFormatError
        A file cannot be read, is of another kind, or holds what cannot be.
    InputError
        Neither is given, or maps without their heights or heights without maps.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> from radioloc.earth import StationCatalogue
    >>> from radioloc.media import read_radio_atmosphere
    >>> path = pathlib.Path(tempfile.mkdtemp(), "2020336.vmf3_r")
    >>> values = "0.00120480  0.00058178  2.1686  0.1047   951.19   6.89   8.47"
    >>> _ = path.write_text(f"WETTZELL  59184.00  {values}\nWETTZELL  59184.25  {values}\n")
    >>> read_radio_atmosphere([path]).source_of(StationCatalogue.default().get("WETTZELL"))
    'VMF3'
    """
    files = tuple(map(Path, vmf3))
    if not files and gpt3 is None:
        raise InputError("neither a file of VMF3 nor one of GPT3 is given")
    maps = [file for file in files if _is_map(file)]
    if maps and vmf3_orography is None:
        raise InputError(
            f"{maps[0]} is a map of VMF3: name the file of its heights too (orography_ell_1x1 or _5x5), vmf3_orography"
        )
    if vmf3_orography is not None and not maps:
        raise InputError("vmf3_orography goes with maps of VMF3, and none is given; leave it out")
    if maps and len(maps) < len(files):
        sites = next(file for file in files if file not in maps)
        raise InputError(f"{maps[0]} is a map of VMF3, {sites} a file of sites; give files of one kind")
    return RadioAtmosphere(
        sites=read_vmf3_sites(files) if files and not maps else {},
        grids=read_vmf3_grids(maps, vmf3_orography) if maps and vmf3_orography is not None else None,
        gpt3=None if gpt3 is None else read_gpt3(gpt3),
        vmf3_files=files if vmf3_orography is None else (*files, Path(vmf3_orography)),
        gpt3_files=() if gpt3 is None else (Path(gpt3),),
    )


def _is_map(file: Path) -> bool:
    """Recognise maps, which begin with lines of ``! Name: content``, of which one names the types of data."""
    return any(
        line.lstrip(" !").startswith("Data_types") for line in islice(read_lines(file, encoding=ANY_BYTE), 20)
    )


def _named(files: Sequence[Path]) -> str:
    """First of the files and the number of the others, for messages."""
    return str(files[0]) if len(files) == 1 else f"{files[0]} and {len(files) - 1} more"
