"""The study file: what to locate, from which observations, with which model.

Everything about the file's form is here; what the numbers mean is decided where they are used.
"""

from __future__ import annotations

import tomllib
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from radioloc.earth.stations import Station, StationCatalogue
from radioloc.errors import InputError
from radioloc.lunar.position import LunarPosition
from radioloc.measurements.terms import active_terms
from radioloc.studies.toml_table import TomlTable
from radioloc.time import Epochs, epochs_from_strings

POSITION_FORMS = ("geographic", "cartesian", "none")


@dataclass(frozen=True, slots=True)
class ObservationChoice:
    """Which observations take part.

    Parameters
    ----------
    files : tuple of Path
        Files to read, globs already resolved.
    targets, stations : tuple of str or None
        Targets and stations to keep; all where ``None``.
    start, stop : Epochs or None
        First and last epoch to keep, UTC.
    hours : float or None
        Length of the arc from ``start``, or from the first observation.
    extra_sigma_m : float
        Error of the model and of the instruments beyond what the files state, added in quadrature to each stated
        sigma, metres of the whole light path.
    """

    files: tuple[Path, ...] = ()
    targets: tuple[str, ...] | None = None
    stations: tuple[str, ...] | None = None
    start: Epochs | None = None
    stop: Epochs | None = None
    hours: float | None = None
    extra_sigma_m: float = 0.0


@dataclass(frozen=True, slots=True)
class HeightPrior:
    """Prior on the height above the 1737.4 km sphere."""

    height_m: float
    sigma_m: float


@dataclass(frozen=True, slots=True)
class EstimateChoice:
    """What is estimated, with which priors.

    Parameters
    ----------
    position : {"geographic", "cartesian", "none"}
        Parameters of the position: longitude, latitude, height; x, y, z; or held.
    range_bias : tuple of str or "all" or "none"
        Stations whose range bias is estimated.
    range_bias_sigma_m : float or None
        Prior sigma of each bias about zero; free where ``None``.
    time_bias, time_bias_sigma_s
        Likewise for an offset of a station's time tags.
    height_prior : HeightPrior or None
        Prior on the height.
    ephemeris_sigma_m : tuple of float
        Error to be assumed of the lunar ephemeris and orientation as seen in the position: east, north, up.
    rejection_sigma : float
        An observation is rejected when its residual exceeds so many of its expected sigmas.
    """

    position: str = "geographic"
    range_bias: tuple[str, ...] | str = "none"
    range_bias_sigma_m: float | None = None
    time_bias: tuple[str, ...] | str = "none"
    time_bias_sigma_s: float | None = None
    height_prior: HeightPrior | None = None
    ephemeris_sigma_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rejection_sigma: float = 5.0


@dataclass(frozen=True, slots=True)
class ModelChoice:
    """Kernels, tables and terms of the model.

    Parameters
    ----------
    terms : frozenset of str
        Active terms.
    ephemeris, libration : str
        Registered name or path of the SPK and of the binary PCK.
    earth_orientation : Path or None
        A C04 or finals2000A file in place of the installed tables.
    """

    terms: frozenset[str] = field(default_factory=active_terms)
    ephemeris: str = "DE421"
    libration: str = "DE421"
    earth_orientation: Path | None = None


@dataclass(frozen=True, slots=True)
class Reference:
    """A known position to compare with."""

    position: LunarPosition
    name: str = "reference"


@dataclass(frozen=True, slots=True)
class Study:
    """A whole study, as read from a file or built in Python.

    Parameters
    ----------
    target : LunarPosition
        A-priori position, where the fit starts (and stays, if the position is not estimated).
    observations : ObservationChoice
    estimate : EstimateChoice
    model : ModelChoice
    catalogue : StationCatalogue
        The stations known to the study.
    reference : Reference or None
    name : str
        Shown on the result card.
    """

    target: LunarPosition
    observations: ObservationChoice = field(default_factory=ObservationChoice)
    estimate: EstimateChoice = field(default_factory=EstimateChoice)
    model: ModelChoice = field(default_factory=ModelChoice)
    catalogue: StationCatalogue = field(default_factory=StationCatalogue.default)
    reference: Reference | None = None
    name: str = "study"


def read_study(path: str | Path) -> Study:
    """Read a study file.

    Parameters
    ----------
    path : path-like
        A TOML file; paths in it are relative to its folder.

    Raises
    ------
    InputError
        The file cannot be read, is not TOML, or has an unknown key or an unusable value; the message names it.
    """
    path = Path(path)
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError(f"{path}: there is no such study file") from None
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: the study file cannot be read: {error}") from None
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{path}: not valid TOML: {error}") from None
    top = TomlTable(path, "", content)
    target = top.table("target")
    if target is None:
        raise InputError(f"{path}: [target] is missing; it gives the a-priori position")
    reference = top.table("reference")
    position, _ = _position(target)
    study = Study(
        target=position,
        observations=_observations(top.table("observations"), path),
        estimate=_estimate(top.table("estimate")),
        model=_model(top.table("model"), path),
        catalogue=_stations(top.table("stations")),
        reference=None if reference is None else Reference(*_position(reference)),
        name=path.stem,
    )
    top.finish()
    return study


def _position(table: TomlTable) -> tuple[LunarPosition, str]:
    name = table.text("name") or table.name
    frame = table.text("frame") or "ME_DE421"
    xyz_m = table.vector("position_m")
    lon, lat, height = (table.number(key) for key in ("longitude_deg", "latitude_deg", "height_m"))
    geographic = {"longitude_deg": lon, "latitude_deg": lat, "height_m": height}
    given = [key for key, value in geographic.items() if value is not None]
    table.finish()
    if xyz_m is not None and given:
        table.fail(
            "position_m", f"give either position_m or longitude and latitude, not both ({', '.join(given)})"
        )
    try:
        if xyz_m is not None:
            return LunarPosition.from_cartesian(xyz_m, frame), name
        if lon is not None and lat is not None and height is not None:
            return LunarPosition.from_selenographic(lon, lat, height, frame), name
    except InputError as error:
        table.fail("position", str(error))
    missing = [key for key in geographic if key not in given]
    table.fail(
        missing[0], "is missing; a position is longitude_deg, latitude_deg and height_m, or position_m"
    )


def _observations(table: TomlTable | None, path: Path) -> ObservationChoice:
    if table is None:
        raise InputError(f"{path}: [observations] is missing; it names the files to read")
    patterns = table.texts("files")
    if not patterns:
        table.fail("files", "is missing; name at least one file (relative to the study file, globs allowed)")
    files: list[Path] = []
    for pattern in patterns:
        found = _matches(path.parent, pattern)
        if not found:
            table.fail("files", f"{pattern!r} matches no file in {path.parent.resolve()}")
        files += [f for f in found if f not in files]
    start, stop = (_epoch(table, key) for key in ("start", "stop"))
    choice = ObservationChoice(
        files=tuple(files),
        targets=table.texts("targets"),
        stations=table.texts("stations"),
        start=start,
        stop=stop,
        hours=table.number("hours", positive=True),
        extra_sigma_m=table.number("extra_sigma_m") or 0.0,
    )
    table.finish()
    if choice.extra_sigma_m < 0:
        table.fail("extra_sigma_m", f"must not be negative, not {choice.extra_sigma_m!r}")
    if start is not None and stop is not None and start.mjd[0] >= stop.mjd[0]:
        table.fail("stop", "must be later than start")
    return choice


def _matches(folder: Path, pattern: str) -> list[Path]:
    plain = folder / pattern
    if plain.is_file():
        return [plain]
    if Path(pattern).is_absolute():
        anchor = Path(Path(pattern).anchor)
        return sorted(p for p in anchor.glob(str(Path(pattern).relative_to(anchor))) if p.is_file())
    return sorted(p for p in folder.glob(pattern) if p.is_file())


def _epoch(table: TomlTable, key: str) -> Epochs | None:
    value = table.take(key)
    if value is None:
        return None
    try:
        # TOML dates arrive as datetime objects; their ISO form is what the text form would be.
        text = value if isinstance(value, str) else value.isoformat().replace("+00:00", "")
        return epochs_from_strings(text)
    except (AttributeError, InputError) as error:
        table.fail(key, str(error) if isinstance(error, InputError) else f"must be a UTC date, not {value!r}")


def _estimate(table: TomlTable | None) -> EstimateChoice:
    if table is None:
        return EstimateChoice()
    default = EstimateChoice()
    prior = table.table("height_prior")
    choice = EstimateChoice(
        position=table.choice("position", POSITION_FORMS) or default.position,
        range_bias=_station_names(table, "range_bias"),
        range_bias_sigma_m=table.number("range_bias_sigma_m", positive=True),
        time_bias=_station_names(table, "time_bias"),
        time_bias_sigma_s=table.number("time_bias_sigma_s", positive=True),
        height_prior=None if prior is None else _height_prior(prior),
        ephemeris_sigma_m=_east_north_up(table, "ephemeris_sigma_m"),
        rejection_sigma=table.number("rejection_sigma", positive=True) or default.rejection_sigma,
    )
    table.finish()
    return choice


def _station_names(table: TomlTable, key: str) -> tuple[str, ...] | str:
    value = table.take(key)
    if value is None:
        return "none"
    if isinstance(value, str) and value in ("all", "none"):
        return value
    if isinstance(value, list) and all(isinstance(v, str) for v in value):
        return tuple(value)
    table.fail(key, f'must be a list of stations, "all" or "none", not {value!r}')


def _height_prior(table: TomlTable) -> HeightPrior:
    height_m = table.number("height_m")
    sigma_m = table.number("sigma_m", positive=True)
    if "dem" in table:
        table.fail("dem", "terrain models are not read yet; give the height itself as height_m")
    table.finish()
    if height_m is None or sigma_m is None:
        table.fail("height_m", "height_m and sigma_m are both needed, in metres")
    return HeightPrior(height_m, sigma_m)


def _east_north_up(table: TomlTable, key: str) -> tuple[float, float, float]:
    value = table.take(key)
    if value is None:
        return (0.0, 0.0, 0.0)
    values = value if isinstance(value, list) else [value] * 3
    if len(values) != 3:
        table.fail(key, f"must be one number or three (east, north, up), not {value!r}")
    east, north, up = (table.as_number(key, v) for v in values)
    if min(east, north, up) < 0:
        table.fail(key, f"must not be negative, not {value!r}")
    return east, north, up


def _model(table: TomlTable | None, path: Path) -> ModelChoice:
    if table is None:
        return ModelChoice()
    default = ModelChoice()
    try:
        terms = active_terms(table.texts("off") or ())
    except InputError as error:
        table.fail("off", str(error))
    eop = table.text("earth_orientation")
    choice = ModelChoice(
        terms=terms,
        ephemeris=_kernel(table.text("ephemeris"), path) or default.ephemeris,
        libration=_kernel(table.text("libration"), path) or default.libration,
        earth_orientation=None if eop is None else path.parent / eop,
    )
    table.finish()
    return choice


def _kernel(name: str | None, path: Path) -> str | None:
    """A registered name as it is; anything that looks like a file relative to the study file."""
    if name is None or not Path(name).suffix:
        return name
    return str(path.parent / name)


def _stations(table: TomlTable | None) -> StationCatalogue:
    catalogue = StationCatalogue.default()
    if table is None:
        return catalogue
    for entry in table.tables():
        name = entry.name.removeprefix("stations.")
        itrf_m = entry.vector("itrf_m")
        if itrf_m is None:
            entry.fail("itrf_m", "is missing; give the station's ITRF x, y, z in metres")
        velocity_m_yr = entry.vector("velocity_m_yr")
        epoch_year = entry.number("epoch")
        aliases = entry.texts("aliases") or ()
        entry.finish()
        try:
            station = Station(
                name=name,
                aliases=aliases,
                kind="ttc",
                itrf_m=np.array(itrf_m),
                epoch_year=2000.0 if epoch_year is None else epoch_year,
                quality="survey",
                source="study file",
                velocity_m_yr=None if velocity_m_yr is None else np.array(velocity_m_yr),
            )
        except InputError as error:
            entry.fail("itrf_m", str(error))
        catalogue = catalogue.with_station(station)
    return catalogue
