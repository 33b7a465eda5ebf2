"""Tracking stations: positions of their reference points on the crust, and accuracy of the positions.

The reference point of measurements is the intersection of a telescope's axes. Its position in the ITRF is linear in
time with the plate. Other modules of this package add displacements (tides, loading).

Earlier realizations of the ITRF are transformed to ITRF2020, the frame of Earth orientation. Seven parameters and their
rates transform ITRF2020 to each earlier frame (Altamimi et al. 2023; IERS Conventions 2010, equation 4.3):

    x_earlier = x + T + D x + R x,    R x = (-R3 y + R2 z, R3 x - R1 z, -R2 x + R1 y),

all at the epoch of the position. The inverse uses the opposite signs, accurate to some nanometres.

The ITRF93 of the Deep Space Network has the orientation of ITRF93, which rotates against the others by 7 mm a year, but
origin and scale of later frames: with the rotations alone its coordinates (DSN 810-005, module 301) agree with
those of GSFC's VLBI solution 2019d to 3 to 10 cm in 2020, with all of the parameters to 13 to 16 cm only. So
``"ITRF93_DSN"`` is a frame of its own.
"""

from __future__ import annotations

import csv
import difflib
import math
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cache, lru_cache
from importlib.resources import files
from typing import Any

import numpy as np

from radioloc.constants import ARCSEC_RAD, J2000_JD
from radioloc.earth.blq import BlqCoefficients, parse_blq
from radioloc.earth.geodesy import geodetic_from_itrf, itrf_from_geodetic
from radioloc.errors import InputError, StationError
from radioloc.quantities import EpochsLike, FloatLike, accepts_quantities
from radioloc.units import as_metres, in_unit, set_fields
from radioloc.vectors import Floats

_EPOCH_YEAR = 2015.0
_UNITS = np.array([1e-3, 1e-3, 1e-3, 1e-9, *3 * [1e-3 * ARCSEC_RAD]])


@cache
def _parameters() -> dict[str, Floats]:
    """Return parameters from ITRF2020 at 2015.0 and their rates by frame, m and rad, shape (2, 7)."""
    text = (files("radioloc.earth") / "data" / "itrf2020_to_itrf.csv").read_text(encoding="utf-8")
    rows = csv.reader(line for line in text.splitlines() if not line.startswith(("#", "frame")))
    published = {name: np.array(numbers, dtype=np.float64).reshape(2, 7) * _UNITS for name, *numbers in rows}
    return {"ITRF2020": np.zeros((2, 7))} | published


def frames() -> tuple[str, ...]:
    """Return the names of the frames, the latest first."""
    return tuple(_parameters())


def to_itrf2020(
    frame: str, itrf_m: Floats, velocity_m_yr: Floats, epoch_year: float
) -> tuple[Floats, Floats]:
    """Transform position (m) and velocity (m per Julian year) at an epoch from one of :func:`frames` to ITRF2020."""
    at_2015, rate = _parameters()[frame]
    away_m = _difference(at_2015 + (epoch_year - _EPOCH_YEAR) * rate, itrf_m)
    return itrf_m - away_m, velocity_m_yr - _difference(rate, itrf_m)


def _difference(parameters: Floats, itrf_m: Floats) -> Floats:
    return np.asarray(parameters[:3] + parameters[3] * itrf_m + np.cross(parameters[4:], itrf_m))


KINDS = ("llr", "vlbi", "ttc")
_SIGMA_M = {"survey": 0.01, "approximate": 1.0, "rounded": 100.0}
QUALITIES = tuple(_SIGMA_M)
MOUNTS = ("azimuth_elevation", "equatorial", "xy_north", "xy_east")
"""Antenna mounts, by the fixed axis: vertical, parallel to the Earth's, horizontal to the north or to the east."""

NETWORKS = {
    "DSN": "Deep Space Communication",
    "GOLDSTONE": "Goldstone",
    "CANBERRA": "Canberra",
    "MADRID": "Madrid",
    "ESTRACK": "ESTRACK",
    "JAXA": "JAXA",
    "CDSN": "Chinese Deep Space Network",
    "CVN": "Chinese VLBI Network",
    "EVN": "European VLBI Network",
    "LBA": "Long Baseline Array",
}
"""Networks by the text that the complexes of their stations have in common."""

_DAYS_PER_JULIAN_YEAR = 365.25
_RADIUS_RANGE_M = (6.35e6, 6.39e6)
_HEIGHT_RANGE_M = (-1.0e3, 1.0e4)  # of ground above the ellipsoid
_MIN_MOVED_M = 5.0e4  # by which a station with a catalogue's name is another site, or has wrong coordinates
_SAME_SITE_M = 1.0e4
_MAX_AXIS_OFFSET_M = 20.0
_MIN_SIMILARITY = 0.75  # of names, by difflib: KASHY is similar to KASHI (0.8), APACHE not to ZAPALA (0.5)
_MIN_PREFIX = 3
_MAX_SIMILAR = 5


@dataclass(frozen=True, slots=True, eq=False)
class Station:
    """Tracking station.

    Raises
    ------
    StationError
        A field is not usable.
    """

    name: str  #: name in the catalogue
    aliases: tuple[str, ...]  #: other names: codes, CDP pad number
    kind: str  #: "llr", "vlbi", "ttc": laser ranging, VLBI, or tracking, telemetry and command
    itrf_m: Floats  #: (3,), reference point in the `frame` at `epoch_year`, m where it has no unit
    epoch_year: float  #: epoch of the position, Julian year TT
    #: "survey", "approximate", "rounded": accurate to centimetres; to about a metre; or published with errors of
    #: 100 m to 1 km.
    quality: str
    source: str  #: source of the position
    #: (3,), velocity in the `frame`, m per Julian year; None (unknown) keeps the station fixed.
    velocity_m_yr: Floats | None = None
    #: Ocean tide loading; without coefficients the model lacks the term.
    ocean_loading: BlqCoefficients | None = None
    mount: str = "azimuth_elevation"  #: mount of the antenna, by its fixed axis, of :data:`MOUNTS`
    #: Distance of the moving axis from the fixed one, which contains the reference point, in the direction of
    #: pointing, m; if it is None (unknown), the model lacks the term.
    axis_offset_m: float | None = None
    sigma_m: float | None = None  #: standard deviation of each coordinate, m; by default that of the quality
    complex: str = ""  #: observatory or network, and country; empty if unknown
    country: str = ""  #: likewise
    #: Realization of the ITRF of position and velocity, ``"ITRF93"`` to ``"ITRF2020"``; today's WGS 84 is
    #: ITRF2020 to some centimetres.
    frame: str = "ITRF2020"

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not self.name.strip():
            raise StationError("a station needs a name")
        allowed = {"kind": KINDS, "quality": QUALITIES, "mount": MOUNTS, "frame": frames()}
        for field, names in allowed.items():
            if (value := getattr(self, field)) not in names:
                raise StationError(f"station {self.name}: {field} {value!r} is not one of {', '.join(names)}")
        set_fields(self, aliases=tuple(self.aliases))
        year: Any = self.epoch_year
        if hasattr(year, "jyear"):
            set_fields(self, epoch_year=year.tt.jyear)
        self._set_numbers("epoch_year", "yr", ())
        self._set_numbers("itrf_m", "m", (3,))
        optional = {"velocity_m_yr": ("m / yr", (3,)), "sigma_m": ("m", ()), "axis_offset_m": ("m", ())}
        for field, (unit, shape) in optional.items():
            if getattr(self, field) is not None:
                self._set_numbers(field, unit, shape)
        radius_m = math.hypot(*self.itrf_m)
        if not _RADIUS_RANGE_M[0] < radius_m < _RADIUS_RANGE_M[1]:
            raise StationError(
                f"station {self.name} is {radius_m:.6g} m from the geocentre; the ground is between "
                f"{_RADIUS_RANGE_M[0]:.2e} and {_RADIUS_RANGE_M[1]:.2e} m: give metres, geocentric"
                + " (these are kilometres)"
                * (_RADIUS_RANGE_M[0] < 1e3 * radius_m < _RADIUS_RANGE_M[1])
            )
        height_m = _height_m(self.itrf_m)
        if not _HEIGHT_RANGE_M[0] < height_m < _HEIGHT_RANGE_M[1]:
            ground = {name: _height_m(point) for name, point in reordered_coordinates(self.itrf_m).items()}
            corrections = [
                f"with {name} it would be at {other_m:.0f} m"
                for name, other_m in ground.items()
                if _HEIGHT_RANGE_M[0] < other_m < _HEIGHT_RANGE_M[1]
            ]
            raise StationError(
                f"station {self.name} is at {height_m:.0f} m above the ellipsoid, where no ground is: give x, y, z in "
                f"metres, geocentric; {' or '.join(corrections)}"
            )
        if self.sigma_m is not None and not self.sigma_m > 0.0:
            raise StationError(
                f"station {self.name}: sigma_m: expected a number above zero, got {self.sigma_m}"
            )
        if abs(self.axis_offset_m or 0.0) > _MAX_AXIS_OFFSET_M:
            raise StationError(
                f"station {self.name}: no antenna has an axis offset of {self.axis_offset_m} m; give metres, up to "
                f"{_MAX_AXIS_OFFSET_M:g}"
            )

    @classmethod
    @accepts_quantities
    def from_geodetic(
        cls, *, longitude_deg: FloatLike, latitude_deg: FloatLike, height_m: FloatLike, **fields: Any
    ) -> Station:
        """Make a station of east longitude, latitude (deg) and height (m) above the ellipsoid of GRS80 or WGS 84.

        The two ellipsoids differ by 0.1 mm. The other fields are those of the class.

        Examples
        --------
        >>> from radioloc.earth import Station
        >>> place = {"longitude_deg": 76.71, "latitude_deg": 38.42, "height_m": 1200.0}
        >>> words = {"kind": "ttc", "quality": "rounded", "source": "a map", "epoch_year": 2020.0, "aliases": ()}
        >>> Station.from_geodetic(name="MINE", **place, **words).itrf_m.round().tolist()
        [1150441.0, 4870506.0, 3942821.0]
        """
        if not (abs(latitude_deg) <= 90.0 and abs(longitude_deg) <= 360.0 and math.isfinite(height_m)):
            coordinates = (
                f"latitude_deg = {latitude_deg:g}, longitude_deg = {longitude_deg:g}, height_m = {height_m:g}"
            )
            raise StationError(
                f"station {fields.get('name')}: {coordinates}: angles are up to 90 and 360 degrees; are they exchanged?"
            )
        itrf_m = itrf_from_geodetic(np.deg2rad(longitude_deg), np.deg2rad(latitude_deg), height_m)
        return cls(itrf_m=itrf_m, **fields)

    def _set_numbers(self, field: str, unit: str, shape: tuple[int, ...]) -> None:
        """Convert a field to finite numbers without a unit: a float or a read-only array."""
        value = getattr(self, field)
        try:
            bare = as_metres(value, field) if unit == "m" else in_unit(value, unit, field)
            numbers = np.array(bare, dtype=np.float64)
        except InputError as error:
            raise StationError(f"station {self.name}: {error}") from error
        except (TypeError, ValueError):
            numbers = np.array(np.nan)
        if numbers.shape != shape or not np.isfinite(numbers).all():
            requirement = "three finite numbers" if shape else "a finite number"
            raise StationError(f"station {self.name}: {field}: expected {requirement}, got {value}")
        numbers.setflags(write=False)
        set_fields(self, **{field: numbers if shape else float(numbers)})

    def __repr__(self) -> str:
        extras = [] if self.velocity_known else ["velocity not known"]
        extras += [] if self.ocean_loading is not None else ["no ocean loading"]
        return f"<Station {self.name} ({', '.join([self.kind, self.quality, *extras])})>"

    @property
    def velocity_known(self) -> bool:
        """Return whether the station has a velocity; otherwise it is fixed."""
        return self.velocity_m_yr is not None

    @property
    def location(self) -> Any:
        """:attr:`itrf_m` as an astropy ``EarthLocation``.

        Examples
        --------
        >>> from radioloc.earth import StationCatalogue
        >>> StationCatalogue.default().get("WETTZELL").location.height.round()
        <Quantity 665. m>
        """
        from astropy.coordinates import EarthLocation

        return EarthLocation.from_geocentric(*self.itrf_m, unit="m")

    @property
    def position_sigma_m(self) -> float:
        """Standard deviation of each coordinate, m, as stated or by the quality."""
        return _SIGMA_M[self.quality] if self.sigma_m is None else self.sigma_m

    @property
    def itrf2020(self) -> tuple[Floats, Floats]:
        """Position (m) and velocity (m per Julian year) in ITRF2020 at :attr:`epoch_year`.

        A station of unknown velocity is fixed in ITRF2020.
        """
        given_m_yr = np.zeros(3) if self.velocity_m_yr is None else self.velocity_m_yr
        position_m, velocity_m_yr = to_itrf2020(self.frame, self.itrf_m, given_m_yr, self.epoch_year)
        return position_m, velocity_m_yr if self.velocity_known else given_m_yr

    @accepts_quantities
    def position_at(self, tt: EpochsLike) -> Floats:
        """Return the reference point in ITRF2020 at epochs of TT, without tides and loading, m, shape (n, 3)."""
        tt.require("TT")
        position_m, velocity_m_yr = self.itrf2020
        epoch_jd = J2000_JD + (self.epoch_year - 2000.0) * _DAYS_PER_JULIAN_YEAR
        years = ((tt.jd - epoch_jd) + tt.fraction) / _DAYS_PER_JULIAN_YEAR
        return position_m + years[:, np.newaxis] * velocity_m_yr


class StationCatalogue:
    """Stations by name and aliases, whatever their case, spaces, hyphens and underscores; immutable.

    :meth:`default` is the catalogue of the package, to which :meth:`with_station` adds. Two stations with a common name
    or alias are a :class:`StationError`.
    """

    __slots__ = ("_by_key", "_stations")

    def __init__(self, stations: Iterable[Station]) -> None:
        self._stations = tuple(stations)
        self._by_key: dict[str, Station] = {}
        for station in self._stations:
            for label in {_key(label) for label in (station.name, *station.aliases)}:
                namesake = self._by_key.setdefault(label, station)
                if namesake is not station:
                    raise StationError(
                        f"stations {namesake.name} and {station.name} are both called {label!r}"
                    )

    @classmethod
    @cache
    def default(cls) -> StationCatalogue:
        """Return the stations that ship with the library."""
        data = files("radioloc.earth") / "data"
        loading = parse_blq((data / "ocean_loading.blq").read_text(encoding="utf-8"), "ocean_loading.blq")
        lines = (data / "stations.csv").read_text(encoding="utf-8").splitlines()
        rows = csv.DictReader(line for line in lines if not line.startswith("#"))
        return cls(_station_from_row(row, loading) for row in rows)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the stations, in order."""
        return tuple(station.name for station in self._stations)

    def get(self, name: str | int) -> Station:
        """Find a station by its name, an alias or its CDP pad number, whatever the case.

        A :class:`StationError` of an unknown name lists similar names and how to add a station.

        Examples
        --------
        >>> from radioloc.earth import StationCatalogue
        >>> StationCatalogue.default().get("wettzell")
        <Station WETTZELL (llr, survey)>
        """
        station = self._by_key.get(_key(name))
        if station is not None:
            return station
        close = [station.name for label, station in self._by_key.items() if _is_similar(_key(name), label)]
        similar = list(dict.fromkeys(close))[:_MAX_SIMILAR]
        candidates = f"similar: {', '.join(similar)}" if similar else f"known: {', '.join(self.names)}"
        of_site = "name the file of its site under [observations] sites, or "
        raise StationError(
            f"station {str(name)[:40]!r} is not in the catalogue; {candidates}. To use one of your own, "
            f"{of_site if _key(name).startswith(_key('COSPAR')) else ''}"
            "describe it under [stations.NAME] in the study file, or catalogue.with_station(Station(...)) in Python"
        )

    def members(self, name: str) -> tuple[Station, ...]:
        """Return the stations of one of the :data:`NETWORKS`, or the only one with a name as of :meth:`get`.

        Examples
        --------
        >>> from radioloc.earth import StationCatalogue
        >>> [station.name for station in StationCatalogue.default().members("CDSN")]
        ['JIAMUSI', 'KASHI', 'NEUQUEN']
        """
        network = None if name in self else NETWORKS.get(_key(name))
        stations = tuple(station for station in self if network and network in station.complex)
        return stations or (self.get(name),)

    def antenna_notes(self, names: Iterable[str]) -> list[str]:
        """Return a sentence for each complex with more than two antennas among some stations."""
        of_complex: dict[str, list[str]] = {}
        for station in dict.fromkeys(self.get(name) for name in names):
            of_complex.setdefault(station.complex, []).append(station.name)
        return [
            f"each of {len(antennas)} antennas takes part: {', '.join(antennas)} of {name}"
            for name, antennas in of_complex.items()
            if len(antennas) > 2 and name.endswith("Complex")
        ]

    def find(self, text: str) -> tuple[Station, ...]:
        """Return the stations of a network (:data:`NETWORKS`), or with a text in name, alias, complex or country.

        Examples
        --------
        >>> from radioloc.earth import StationCatalogue
        >>> [station.name for station in StationCatalogue.default().find("dss 24")]
        ['DSS-24']
        """
        network = NETWORKS.get(_key(text), text)
        return tuple(
            station
            for station in self
            if network in station.complex
            or any(
                _key(text) in _key(label)
                for label in (station.name, *station.aliases, station.complex, station.country)
            )
        )

    def with_station(self, station: Station) -> StationCatalogue:
        """Return a catalogue with the station added, in place of a station of the same name."""
        former = self._by_key.get(_key(station.name))
        if former is not None and math.dist(former.itrf_m, station.itrf_m) > _MIN_MOVED_M:
            for name, itrf_m in reordered_coordinates(station.itrf_m).items():
                if math.dist(former.itrf_m, itrf_m) < _SAME_SITE_M:
                    raise StationError(
                        f"station {station.name} is {1e-3 * math.dist(former.itrf_m, station.itrf_m):.0f} km from the "
                        f"catalogue's; with {name} it would be {1e-3 * math.dist(former.itrf_m, itrf_m):.1f} km from "
                        "it: correct the coordinates"
                    )
        remaining = [item for item in self._stations if _key(item.name) != _key(station.name)]
        return StationCatalogue([*remaining, station])

    def __getitem__(self, name: str | int) -> Station:
        return self.get(name)

    def __contains__(self, name: object) -> bool:
        return isinstance(name, str | int) and _key(name) in self._by_key

    def __iter__(self) -> Iterator[Station]:
        return iter(self._stations)

    def __len__(self) -> int:
        return len(self._stations)

    def __repr__(self) -> str:
        return f"<StationCatalogue {', '.join(self.names)}>"


def station_name(catalogue: StationCatalogue | None, *names: str) -> str:
    """Return the catalogue's name of a station by the first known of its names, or else its first name."""
    matches = [name for name in names if catalogue is not None and name in catalogue]
    return catalogue[matches[0]].name if catalogue is not None and matches else names[0]


def reordered_coordinates(xyz_m: Floats) -> dict[str, Floats]:
    """Return geocentric coordinates with usual mistakes, exchanged axes or another sign, by their description."""
    x, y, z = xyz_m
    orders = {
        "x and y exchanged": (y, x, z),
        "y and z exchanged": (x, z, y),
        "x and z exchanged": (z, y, x),
        "x, y, z in the order y, z, x": (z, x, y),
        "x, y, z in the order z, x, y": (y, z, x),
        "the other sign of y (longitude counted east)": (x, -y, z),
        "the other sign of x": (-x, y, z),
        "the other sign of z": (x, y, -z),
    }
    mistakes = {name: np.array(order) for name, order in orders.items()}
    place = geodetic_from_itrf(xyz_m)
    if abs(place.longitude_rad) <= 0.5 * math.pi:
        turned = itrf_from_geodetic(place.latitude_rad, place.longitude_rad, place.height_m)
        mistakes["longitude and latitude exchanged"] = turned
    longitude_rad, latitude_rad = math.degrees(place.longitude_rad), math.degrees(place.latitude_rad)
    if abs(longitude_rad) <= math.pi and abs(latitude_rad) <= 0.5 * math.pi:
        in_degrees = itrf_from_geodetic(longitude_rad, latitude_rad, place.height_m)
        mistakes["longitude and latitude in degrees, not radians,"] = in_degrees
    return mistakes


def _height_m(itrf_m: Floats) -> float:
    return float(geodetic_from_itrf(itrf_m).height_m)


def _is_similar(key: str, label: str) -> bool:
    """Return whether names are similar; names with other numbers are those of other antennas."""
    number, of_label = ("".join(re.findall(r"\d", text)) for text in (key, label))
    if key == number:
        return number == of_label
    alike = difflib.SequenceMatcher(None, key, label).ratio() >= _MIN_SIMILARITY
    alike |= len(key) >= _MIN_PREFIX and label.startswith(key)
    return alike and (not number or not of_label or number == of_label)


@lru_cache(4096, typed=True)
def _key(name: str | int) -> str:
    return re.sub(r"[\s_-]", "", str(name)).upper()


def _station_from_row(row: dict[str, str], loading: dict[str, BlqCoefficients]) -> Station:
    velocity = [row[key] for key in ("vx_m_yr", "vy_m_yr", "vz_m_yr")]
    return Station(
        name=row["name"],
        aliases=tuple(filter(None, row["aliases"].split(";"))),
        kind=row["kind"],
        itrf_m=np.array([float(row[key]) for key in ("x_m", "y_m", "z_m")]),
        epoch_year=float(row["epoch_year"]),
        quality=row["quality"],
        source=row["source"],
        velocity_m_yr=np.array([float(v) for v in velocity]) if all(velocity) else None,
        ocean_loading=loading.get(row["loading"] or row["name"]),
        mount=row["mount"] or MOUNTS[0],
        axis_offset_m=float(row["axis_offset_m"]) if row["axis_offset_m"] else None,
        sigma_m=float(row["sigma_m"]) if row["sigma_m"] else None,
        complex=row["complex"],
        country=row["country"],
        frame=row["frame"] or "ITRF2020",
    )
