"""Physical model of predictions: ephemeris, lunar and Earth orientation, stations, media and active terms.

A study switches named terms off with ``[model] off = [...]``. A table of terms has the effect of each term on each
computed value.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from radioloc.earth.eop import EopTable
from radioloc.earth.eop_prediction import extended
from radioloc.earth.orientation import EarthOrientation
from radioloc.earth.stations import StationCatalogue
from radioloc.ephemeris import Ephemeris, LunarOrientation
from radioloc.errors import InputError, StationError
from radioloc.kernels import KernelFile
from radioloc.measurements.equipment_delays import EquipmentDelays
from radioloc.measurements.light_path import PLANETS_MM
from radioloc.measurements.sources import Sources
from radioloc.media import MEDIA
from radioloc.media.csp import MediaCalibrations
from radioloc.media.ionosphere import ElectronContent, Ionosphere
from radioloc.media.medium import Medium
from radioloc.media.radio_atmosphere import RadioAtmosphere
from radioloc.media.troposphere import Troposphere
from radioloc.plugins import DerivedMapping


def _terms() -> dict[str, str]:
    terms = {
        "shapiro": "gravitational delay by the Sun, the Earth, the Moon and the planets",
        "tdb_tt": "difference of TDB - TT between the ends of the light path",
        "galactic_aberration": "motion of quasars since 2015.0 by the solar system's acceleration in the Galaxy",
        "station_proper_time": "rate of free-running clocks of stations by their heights",
        "target_proper_time": "rate of the target's clock by its speed and gravity, one-way",
        "troposphere": MEDIA["troposphere"].description,
        "ionosphere": MEDIA["ionosphere"].description,
        "transponder_delay": "delay of the target's transponder, if stated",
        "station_delay": "delay of the stations' equipment between clock and reference point, if stated",
        "antenna_axis_offset": MEDIA["antenna_axis_offset"].description,
        "solid_earth_tide": "displacement of the stations by the solid Earth tide",
        "pole_tide": "displacement of the stations by the solid Earth pole tide",
        "ocean_loading": "displacement of the stations by ocean tide loading",
        "tidal_geocentre": "motion of the stations with the solid Earth about the centre of mass, by the ocean tides",
        "station_velocity": "motion of the stations since the epoch of their coordinates",
        "subdaily_eop": "diurnal and semidiurnal ocean tides and libration in pole and UT1",
        "earth_scale": "scale (TT to TDB, solar potential) of geocentric station positions in the barycentric frame",
        "earth_lorentz": "Lorentz contraction of geocentric station positions along the Earth's velocity",
        "lunar_tide": "displacement of the point on the Moon by the solid tide of Earth and Sun",
        "lunar_tide_constant": "the constant part of that tide",
        "lunar_scale": "scale of positions on the Moon in the barycentric frame, as for the Earth",
        "lunar_lorentz": "Lorentz contraction of the point's position along the Moon's velocity",
    }
    return terms | {name: medium.description for name, medium in MEDIA.items() if name not in terms}


TERMS: Mapping[str, str] = DerivedMapping(_terms)
"""Names and descriptions of terms."""


def active_terms(off: Iterable[str] = ()) -> frozenset[str]:
    """Return the names of :data:`TERMS` without some."""
    off, terms = list(off), tuple(TERMS)
    for name in off:
        if name not in terms:
            matches = difflib.get_close_matches(name, terms, n=1)
            hint = f" (did you mean {matches[0]!r}?)" if matches else ""
            raise InputError(f"term of the model: expected one of {', '.join(terms)}, got {name!r}{hint}")
    return frozenset(terms) - frozenset(off)


@dataclass(frozen=True, slots=True)
class PhysicalModel:
    """Kernels, tables and active terms of predictions, from :meth:`PhysicalModel.build`."""

    ephemeris: Ephemeris
    libration: LunarOrientation  #: of the same ephemeris
    earth: EarthOrientation
    catalogue: StationCatalogue
    terms: frozenset[str]  #: active names of TERMS
    ionosphere: ElectronContent | None = None  #: None: radio signals have no ionospheric delay
    delays: EquipmentDelays = field(default_factory=EquipmentDelays)  #: by the catalogue's names of stations
    radio_atmosphere: RadioAtmosphere | None = None  #: VMF3 and GPT3 files
    sources: Sources = field(default_factory=dict)  #: at infinity, by their names
    free_clocks: tuple[str, ...] = ()  #: stations whose clocks keep proper time, by the catalogue's names
    media_calibrations: MediaCalibrations | None = None  #: of the Deep Space Network
    max_extrapolation_s: float = 1e-3  #: of straight motions near an event: 20 nm of a station

    @classmethod
    def build(
        cls,
        *,
        ephemeris: str | Path = "DE421",
        libration: str | Path = "DE421",
        earth_orientation: str | Path | None = None,
        eop_beyond: str | None = None,
        catalogue: StationCatalogue | None = None,
        ionosphere: ElectronContent | None = None,
        delays: EquipmentDelays | None = None,
        radio_atmosphere: RadioAtmosphere | None = None,
        media_calibrations: MediaCalibrations | None = None,
        free_clocks: Iterable[str] = (),
        sources: Sources | None = None,
        off: Iterable[str] = (),
    ) -> PhysicalModel:
        """Open the kernels and tables; by default those of the package, without media that need files.

        Arguments are the keys of ``[model]``, as the reference of the study file describes them, with what readers
        return in place of files: `ionosphere` (:func:`~radioloc.media.read_ionex`), `radio_atmosphere`
        (:func:`~radioloc.media.read_radio_atmosphere`), `media_calibrations` (:func:`~radioloc.media.read_csp`), and
        `sources` (:func:`~radioloc.measurements.read_sources`).

        Raises
        ------
        KernelError, FileFormatError, InputError
            A file is missing or unusable, the two kernels belong to different ephemerides, or a term is unknown.
        StationError
            A station of a delay or of a free clock is not in the catalogue.
        """
        terms = active_terms(off)
        spk = Ephemeris.open(ephemeris)
        pck = LunarOrientation.open(libration)
        if pck.frame != f"PA_{spk.name}":
            raise InputError(
                f"libration: expected the ephemeris of the positions, {spk.name}, got "
                f"{pck.frame.removeprefix('PA_')}; use kernels of the same ephemeris"
            )
        table = EopTable.packaged() if earth_orientation is None else EopTable.from_file(earth_orientation)
        if eop_beyond is not None:
            table = extended(table, eop_beyond)
        stations = StationCatalogue.default() if catalogue is None else catalogue
        equipment = (delays or EquipmentDelays()).with_catalogue_names(stations)
        try:
            free = tuple(dict.fromkeys(stations.get(name).name for name in free_clocks))
        except StationError as error:
            raise StationError(f"free_clocks: {error}") from None
        model = cls(
            spk,
            pck,
            EarthOrientation(table),
            stations,
            terms,
            ionosphere,
            equipment,
            radio_atmosphere,
            dict(sources or {}),
            free,
            media_calibrations,
        )
        return model.with_terms(terms)

    def __repr__(self) -> str:
        table = self.earth.table
        off = ", ".join(name for name in TERMS if not self.has(name))
        return (
            f"<PhysicalModel {self.ephemeris.name}, Earth orientation {table.first_date} to {table.last_date}, "
            f"{len(self.catalogue)} stations, {f'without {off}' if off else 'all terms'}>"
        )

    def without(self, *names: str) -> PhysicalModel:
        """Return the model without some terms."""
        return self.with_terms(self.terms & active_terms(names))

    def with_terms(self, terms: frozenset[str]) -> PhysicalModel:
        """Return the model with these active terms only."""
        subdaily = "subdaily_eop" in terms
        earth = replace(self.earth, subdaily_tides=subdaily, libration=subdaily)
        return replace(self, earth=earth, terms=terms)

    @property
    def media(self) -> tuple[Medium, ...]:
        """Active media of the legs in the order of evaluation."""
        configured: tuple[Medium, ...] = (
            Troposphere(self.radio_atmosphere, self.media_calibrations),
            Ionosphere(self.ionosphere, self.media_calibrations),
        )
        media = {**MEDIA, **{medium.name: medium for medium in configured}}
        return tuple(medium for name, medium in media.items() if self.has(name))

    def has(self, term: str) -> bool:
        """Return whether a term is active."""
        return term in self.terms

    @property
    def missing_planets(self) -> tuple[str, ...]:
        """Planets that the ephemeris lacks for their active gravitational delay."""
        if not self.has("shapiro"):
            return ()
        return tuple(name for name in PLANETS_MM if name not in self.ephemeris.bodies)

    def provenance(self) -> dict[str, Any]:
        """Return kernels with checksums, tables with dates, and terms switched off, for the provenance of results."""
        return {
            "ephemeris": kernel_record(self.ephemeris.kernel, self.ephemeris.name),
            "lunar_orientation": kernel_record(self.libration.kernel, self.libration.frame),
            "earth_orientation": {
                "tables": list(self.earth.table.sources),
                "first": self.earth.table.first_date,
                "last_measured": self.earth.table.last_measured_date,
                "last": self.earth.table.last_date,
            },
            "terms_off": [name for name in TERMS if name not in self.terms],
        }


def kernel_record(kernel: KernelFile, name: str) -> dict[str, str]:
    """Return the record of a kernel: name, file, checksum and span."""
    return {
        "name": name,
        "file": Path(kernel.path).name,
        "sha256": kernel.sha256,
        "span_tdb": f"{kernel.start_tdb} to {kernel.end_tdb}",
    }
