"""Air above stations, for radio signals: from weather, or from files of VMF3 (weather models) and GPT3 (climate).

Sources in order of preference:

===================  ==================================================================================================
mapping functions    coefficients of VMF3; of GPT3; without files of Niell
hydrostatic, zenith  recorded pressure; VMF3; pressure of GPT3; without files of the standard atmosphere
wet, zenith          VMF3; GPT3, with recorded humidity if there is any; without files recorded or standard weather
===================  ==================================================================================================

Zenith delays of the Deep Space Network's calibrations replace both at stations with cards. A barometer determines the
hydrostatic delay to a millimetre, better than any model (IERS Conventions 2010, section 9.1.1). Humidity on the ground
is a poor measure of the humidity above it, so VMF3's wet delay is preferred.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np

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
from radioloc.vectors import Floats, Indices

_HEIGHT_LIMITS_M = (-500.0, 9000.0)  # validity of the models of the air


@dataclass(frozen=True, slots=True)
class ZenithAir:
    """Air above the station at one end of each path; NaN for signals other than radio."""

    hydrostatic_m: Floats  # delay at the zenith, one way, shape (n,)
    wet_m: Floats
    hydrostatic_abc: Floats  # coefficients of the mapping function, shape (n, 3)
    wet_abc: Floats
    mapping_height_m: Floats  # of the station above the height of the hydrostatic coefficients, shape (n,)

    def mapping(self, elevation_rad: Floats, rows: Indices | slice) -> MappingFactors:
        """Return the mapping functions of some rows at their elevations."""
        hydrostatic_abc, wet_abc = [*self.hydrostatic_abc[rows].T], [*self.wet_abc[rows].T]
        return mapping_factors(elevation_rad, self.mapping_height_m[rows], hydrostatic_abc, wet_abc)


@dataclass(frozen=True, slots=True, eq=False)
class RadioAtmosphere:
    """Files of VMF3 and GPT3: series by the station's name in the files, maps, and climate for the other stations."""

    sites: dict[str, Vmf3Site]
    grids: Vmf3Grids | None
    gpt3: Gpt3Grid | None
    vmf3_files: tuple[Path, ...] = ()
    gpt3_files: tuple[Path, ...] = ()

    def source_of(self, station: Station) -> str:
        """Return the source for a station, ``"VMF3"`` or ``"GPT3"``; without one raise an InputError."""
        if self.grids is not None or self._site(station) is not None:
            return "VMF3"
        if self.gpt3 is not None:
            return "GPT3"
        other_names = f" (nor {', '.join(station.aliases)})" if station.aliases else ""
        raise InputError(
            f"{_named(self.vmf3_files)}: station {station.name}{other_names} is missing, the files have "
            f"{', '.join(sorted(self.sites))}; add its files, or maps, or GPT3 for such stations ([model] gpt3)"
        )

    def _site(self, station: Station) -> Vmf3Site | None:
        names = {name.upper() for name in (station.name, *station.aliases)}
        return next((site for name, site in self.sites.items() if name.upper() in names), None)

    def air_at(
        self, station: Station, place: tuple[float, float, float], epochs: Epochs, recorded: Floats
    ) -> tuple[Floats, ...]:
        """Return the fields of :class:`ZenithAir` at a station; arguments as :func:`air_from_weather`."""
        files = self.vmf3_files if self.source_of(station) == "VMF3" else self.gpt3_files
        source = self._site(station) or self.grids or self.gpt3
        assert source is not None  # checked by source_of
        try:
            values = source.values_at(epochs, *place)
        except (CoverageError, InputError) as error:
            error.args = (f"{_named(files)}, for station {station.name}: {error}",)
            raise
        latitude_rad, longitude_rad, height_m = place
        b_h, b_w, c_h, c_w = vmf3_bc(latitude_rad, longitude_rad, day_of_year(epochs))
        by_pressure_m = zenith_hydrostatic_delay_m(recorded[0], latitude_rad, height_m)
        if isinstance(values, Vmf3Values):
            hydrostatic_m, wet_m = values.zenith_hydrostatic_m, values.zenith_wet_m
            height_m = values.mapping_height_m
        else:
            hydrostatic_m = zenith_hydrostatic_delay_m(values.pressure_hpa, latitude_rad, height_m)
            vapour_hpa = water_vapour_pressure_hpa(recorded[1], recorded[2], recorded[0])
            wet_m = zenith_wet_delay_askne_nordius_m(
                np.where(np.isnan(vapour_hpa), values.vapour_pressure_hpa, vapour_hpa),
                values.mean_temperature_k,
                values.vapour_decrease_factor,
            )
        return (
            np.where(np.isnan(by_pressure_m), hydrostatic_m, by_pressure_m),
            wet_m,
            np.stack([values.hydrostatic_a, b_h, c_h], axis=-1),
            np.stack([values.wet_a, b_w, c_w], axis=-1),
            np.full(len(epochs), height_m),
        )


def air_from_weather(
    place: tuple[float, float, float], epochs: Epochs, recorded: Floats
) -> tuple[Floats, ...]:
    """Return the fields of :class:`ZenithAir` at a place from recorded weather, else from the standard atmosphere."""
    # `place`: latitude, longitude (rad), height (m); `recorded`: pressure (hPa), temperature (K), relative humidity,
    # or NaN, shape (3, n). Temperature and humidity are used only together.
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


def zenith_air(
    end: LegEnd, files: RadioAtmosphere | None, calibrations: MediaCalibrations | None = None
) -> ZenithAir:
    """Return the air above the stations at one end of paths for radio signals."""
    n = len(end)
    air = tuple(np.full(shape, np.nan) for shape in (n, n, (n, 3), (n, 3), n))
    weather = end.weather
    recorded = np.stack([weather.pressure_hpa, weather.temperature_k, weather.relative_humidity])
    recorded = np.where(end.has_weather, recorded, np.nan)
    for i, station in enumerate(end.stations):
        geodetic = geodetic_from_itrf(station.itrf_m)
        place = float(geodetic.latitude_rad), float(geodetic.longitude_rad), float(geodetic.height_m)
        if not _HEIGHT_LIMITS_M[0] <= place[2] <= _HEIGHT_LIMITS_M[1]:
            raise InputError(
                f"height of {station.name}: the troposphere is valid from {_HEIGHT_LIMITS_M[0]:g} to "
                f"{_HEIGHT_LIMITS_M[1]:g} m, got {place[2]:.6g} m; correct its coordinates"
            )
        rows = np.flatnonzero(end.radio & (end.station_index == i))
        if not len(rows):
            continue
        epochs, weather_of_rows = end.epoch[rows], recorded[:, rows]
        if files is None:
            air_of_rows = air_from_weather(place, epochs, weather_of_rows)
        else:
            air_of_rows = files.air_at(station, place, epochs, weather_of_rows)
        for column, part in zip(air, air_of_rows, strict=True):
            column[rows] = part
        if calibrations is not None:
            for phase in (False, True):
                selected = rows[end.phase[rows] == phase]
                for column, model in ((air[0], DRY), (air[1], WET)):
                    zenith_m = calibrations.zenith_m(station, end.epoch[selected], model, phase)
                    if zenith_m is not None:
                        column[selected] = zenith_m
    return ZenithAir(*air)


def read_radio_atmosphere(
    vmf3: Sequence[str | Path] = (), vmf3_orography: str | Path | None = None, gpt3: str | Path | None = None
) -> RadioAtmosphere:
    r"""Read files of VMF3, of sites or maps, and of GPT3.

    Parameters
    ----------
    vmf3 : sequence of path-like
        Site files, or maps of several epochs.
    vmf3_orography : path-like, optional
        File of the heights of maps, ``orography_ell_1x1`` or ``orography_ell_5x5``.
    gpt3 : path-like, optional
        ``gpt3_5.grd`` or ``gpt3_1.grd``.

    Raises
    ------
    FileFormatError
        A file cannot be read, is of another kind, or has impossible values.
    InputError
        Files are missing, maps lack their heights, heights lack maps, or maps and site files are mixed.

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
        raise InputError("expected files of VMF3 or GPT3, got none")
    maps = [file for file in files if _is_map(file)]
    if maps and len(maps) < len(files):
        sites = next(file for file in files if file not in maps)
        raise InputError(f"vmf3: expected maps or site files, got both: {maps[0]}, {sites}")
    if bool(maps) != (vmf3_orography is not None):
        raise InputError(
            "vmf3_orography: expected the file of heights (orography_ell_1x1 or _5x5) together with maps of VMF3, "
            f"got {vmf3_orography} with {len(maps)} maps"
        )
    return RadioAtmosphere(
        sites=read_vmf3_sites(files) if files and not maps else {},
        grids=read_vmf3_grids(maps, vmf3_orography) if maps and vmf3_orography is not None else None,
        gpt3=None if gpt3 is None else read_gpt3(gpt3),
        vmf3_files=files if vmf3_orography is None else (*files, Path(vmf3_orography)),
        gpt3_files=() if gpt3 is None else (Path(gpt3),),
    )


def _is_map(file: Path) -> bool:
    """Return whether a file is a map, with a line ``! Data_types: ...`` in its header."""
    return any(
        line.lstrip(" !").startswith("Data_types") for line in islice(read_lines(file, encoding=ANY_BYTE), 20)
    )


def _named(files: Sequence[Path]) -> str:
    """Return the name of the first file and the number of the others, for messages."""
    return str(files[0]) if len(files) == 1 else f"{files[0]} and {len(files) - 1} more"
