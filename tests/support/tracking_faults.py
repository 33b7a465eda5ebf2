"""Faults of tracking: mistakes of users and of instruments, each with the names by which a fit should report it.

A fault changes the observations or the study of a :class:`~fault_worlds.Case`. A cell is a fault in a world. The result
of a fit is compared with the true position and sorted into one of the classes of :data:`OUTCOMES`.
"""

import re
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from fault_worlds import Case, World, with_height_prior
from scipy.stats import chi2

import radioloc
from radioloc import Observations, Study
from radioloc.constants import C_M_S
from radioloc.dynamics import GravityField, Impulse
from radioloc.earth import StationCatalogue
from radioloc.earth.geodesy import rot_itrf_to_enu
from radioloc.errors import RadiolocError
from radioloc.measurements import Link
from radioloc.simulation.noise import generator
from radioloc.time import Epochs, tai_to_utc, utc_to_tai, utc_to_tt

LIMIT_PROBABILITY = 0.99  # of 3.4 sigmas in three dimensions, common to all targets of a world
PASS_GAP_S = 3600.0

RADIO = ("dsn", "three-way", "vlbi")
TRACKING = (*RADIO, "llr")
ALL = (*TRACKING, "grail")

Change = Callable[[World, Case, np.random.Generator], Case]
Rows = Callable[[World, Observations], np.ndarray]


@dataclass(frozen=True)
class Fault:
    """Change of a case, and a pattern of the names of the culprit with `{station}` and `{partner}` of the world."""

    name: str
    culprit: str
    change: Change
    worlds: tuple[str, ...]

    def pattern(self, world: World) -> re.Pattern:
        """Pattern of the names of the culprit in a world."""
        names = {"station": re.escape(world.station), "partner": re.escape(world.partner)}
        return re.compile(self.culprit.format(**names), re.IGNORECASE)


# Rows of observations


def by_link(observations: Observations, value: Callable[[Link], float]) -> np.ndarray:
    """Return a value of its link for each observation, shape (n,)."""
    return np.array([value(link) for link in observations.links])[observations.link]


def rows_of(observations: Observations, station: str | None = None, kind: str | None = None) -> np.ndarray:
    """Return a mask of the observations that a station receives, and of a type."""
    receives = by_link(
        observations,
        lambda x: station in (None, x.receiver) or (x.differenced and station == x.transmitter),
    )
    return receives & ((observations.types() == kind) if kind else True)


def signs_of(observations: Observations, station: str) -> np.ndarray:
    """Return the sign of a delay of reception at a station in each value, shape (n,)."""
    return by_link(observations, lambda link: link.reception_signs.get(station, 0.0))


def of_kind(kind: str | None, *, of_station: bool = False) -> Rows:
    """Select the observations of a type, of all stations or of that of the world."""
    return lambda world, table: rows_of(table, world.station if of_station else None, kind)


def mask(observations: Observations, index: np.ndarray) -> np.ndarray:
    """Return a mask of some observations, from their indices."""
    return np.isin(np.arange(len(observations)), index)


def seconds(observations: Observations) -> np.ndarray:
    """Return seconds since the first observation, shape (n,)."""
    tai = utc_to_tai(observations.epoch)
    time_s = tai.seconds_since(tai[np.zeros(len(observations), dtype=int)])
    return time_s - time_s.min()


def passes_of(observations: Observations, rows: np.ndarray) -> list[np.ndarray]:
    """Return the indices of some observations by pass."""
    index = np.flatnonzero(rows)
    index = index[np.argsort(seconds(observations)[index], kind="stable")]
    return np.split(index, np.flatnonzero(np.diff(seconds(observations)[index]) > PASS_GAP_S) + 1)


def station_ranges(world: World, observations: Observations) -> np.ndarray:
    """Return a mask of the ranges that the main station receives: that of the world, unless it has only delays."""
    ranges = rows_of(observations, world.station, "range")
    return ranges if ranges.any() else rows_of(observations, "KASHI", "range")


def second_half(world: World, observations: Observations) -> np.ndarray:
    """Return a mask of the second half of the ranges of the main station."""
    index = np.flatnonzero(station_ranges(world, observations))
    return mask(observations, index[len(index) // 2 :])


def first_pass(world: World, observations: Observations) -> np.ndarray:
    """Return a mask of the first pass of the main station with five ranges."""
    passes = passes_of(observations, station_ranges(world, observations))
    return mask(observations, next(index for index in passes if len(index) >= 5))


def short_run(world: World, observations: Observations) -> np.ndarray:
    """Return a mask of a run of ranges of the main station, a quarter of its ranges and at most 26."""
    index = np.flatnonzero(station_ranges(world, observations))
    first = len(index) // 4
    return mask(observations, index[first : first + min(26, len(index) // 4)])


# Changes of observations


def with_columns(case: Case, **columns: object) -> Case:
    """Return the case with other columns of its observations."""
    return replace(case, observations=replace(case.observations, **columns))


def with_values(case: Case, added_m: np.ndarray) -> Case:
    """Return the case with errors added to the values."""
    return with_columns(case, value_m=case.observations.value_m + added_m)


def added(errors_m: Rows) -> Change:
    """Add errors to the values."""
    return lambda world, case, _: with_values(case, errors_m(world, case.observations))


def multiplied(less_one: float, rows: Rows) -> Change:
    """Multiply some values by a factor, given less one."""
    return added(lambda world, table: less_one * table.value_m * rows(world, table))


def later(case: Case, shift_s: np.ndarray) -> Case:
    """Return the case with time tags that are later by some seconds."""
    tai = utc_to_tai(case.observations.epoch)
    return with_columns(case, epoch=tai_to_utc(tai.shifted(np.broadcast_to(shift_s, len(tai)))))


def station_offset(size: float) -> Change:
    """Add an offset to the values of a station, in units of the world's length."""
    return added(lambda world, table: size * world.length_m * signs_of(table, world.station))


def range_offset(size: float, rows: Rows) -> Change:
    """Add an offset to some observations, in units of the world's length."""
    return added(lambda world, table: size * world.length_m * rows(world, table))


def two_station_offsets(world: World, case: Case, _: np.random.Generator) -> Case:
    """Add offsets of opposite signs to two stations."""
    signs = signs_of(case.observations, world.station) - signs_of(case.observations, world.partner)
    return with_values(case, 30.0 * world.length_m * signs)


def clock_offset(offset_s: float, rate: float = 0.0, jump_s: float = 0.0) -> Change:
    """Add an error of a station's clock at reception."""

    def errors_m(world: World, table: Observations) -> np.ndarray:
        time_s = seconds(table)
        error_s = offset_s + rate * time_s + jump_s * (time_s > 0.5 * time_s.max())
        # A constant error of the clock cancels in a two-way range.
        two_way = by_link(table, lambda link: link.transmitter == link.receiver)
        return C_M_S * error_s * signs_of(table, world.station) * ~two_way

    return added(errors_m)


def tags(shift_s: float, *, of_station: bool = False) -> Change:
    """Shift time tags of all observations or of those of a station."""

    def change(world: World, case: Case, _: np.random.Generator) -> Case:
        return later(case, shift_s * rows_of(case.observations, world.station if of_station else None))

    return change


def tags_as(other_scale: Callable[[Epochs], Epochs]) -> Change:
    """Take time tags of another scale as UTC."""

    def change(world: World, case: Case, _: np.random.Generator) -> Case:
        epoch = other_scale(case.observations.epoch)
        return with_columns(case, epoch=Epochs(epoch.jd, epoch.fraction, "UTC"))

    return change


def transmit_for_receive(world: World, case: Case, _: np.random.Generator) -> Case:
    """Exchange the events of the time tags, transmission and reception."""
    return with_columns(case, tag=(1 - case.observations.tag).astype(np.int8))


def exchanged_stations(first: str = "", second: str = "") -> Change:
    """Exchange the names of two stations in all observations, by default of those of the world."""

    def change(world: World, case: Case, _: np.random.Generator) -> Case:
        names = first or world.station, second or world.partner
        return with_columns(case, links=tuple(_renamed(link, *names) for link in case.observations.links))

    return change


def _renamed(link: Link, first: str, second: str) -> Link:
    names = {first: second, second: first}
    ends = {end: names.get(getattr(link, end), getattr(link, end)) for end in ("transmitter", "receiver")}
    return replace(link, **ends)


def renamed_in_pass(case: Case, rows: np.ndarray, rename: Callable[[Link], Link]) -> Case:
    """Rename the links of the longest pass of some observations."""
    observations = case.observations
    link = observations.link.copy()
    link[max(passes_of(observations, rows), key=len)] += len(observations.links)
    renamed = tuple(map(rename, observations.links))
    changed = replace(observations, links=observations.links + renamed, link=link)
    parts = [changed.select(np.arange(len(link)) == k) for k in range(len(link))]
    return replace(case, observations=Observations.concatenate(parts))


def wrong_station_in_pass(world: World, case: Case, _: np.random.Generator) -> Case:
    """Give the observations of one pass of a station the name of another."""
    rows = rows_of(case.observations, world.station)
    return renamed_in_pass(case, rows, lambda link: _renamed(link, world.station, world.partner))


def wrong_target_in_night(world: World, case: Case, _: np.random.Generator) -> Case:
    """Give the ranges of the longest night to one reflector the name of another."""
    rows = by_link(case.observations, lambda link: link.target == "apollo15")
    return renamed_in_pass(case, rows, lambda link: replace(link, target="apollo14"))


def reversed_link(world: World, case: Case, _: np.random.Generator) -> Case:
    """Exchange the stations of the links between two stations that the world's station has part in."""

    def change(link: Link) -> Link:
        if link.transmitter == link.receiver or world.station not in link.stations:
            return link
        if link.differenced and world.partner not in link.stations:
            return link
        return replace(link, transmitter=link.receiver, receiver=link.transmitter)

    return with_columns(case, links=tuple(map(change, case.observations.links)))


def longest_doppler_pass(world: World, observations: Observations) -> np.ndarray:
    """Return a mask of the longest pass of Doppler of a station."""
    passes = passes_of(observations, rows_of(observations, world.station, "doppler"))
    return mask(observations, max(passes, key=len))


def outliers(fraction: float, size: float, *, of_station: bool = False) -> Change:
    """Add errors of several sizes to a random part of the observations, in stated sigmas."""

    def change(world: World, case: Case, random: np.random.Generator) -> Case:
        n = len(case.observations)
        rows = rows_of(case.observations, world.station if of_station else None)
        rows = rows & (random.random(n) < fraction)
        error = size * (0.5 + random.random(n)) * random.choice([-1.0, 1.0], n)
        return with_values(case, error * case.observations.sigma_m * rows)

    return change


def sigmas(factor: float, *, of_station: bool = False) -> Change:
    """Multiply stated sigmas."""

    def change(world: World, case: Case, _: np.random.Generator) -> Case:
        rows = rows_of(case.observations, world.station if of_station else None)
        return with_columns(case, sigma_m=case.observations.sigma_m * np.where(rows, factor, 1.0))

    return change


def duplicates(shift_s: float) -> Change:
    """Repeat all observations, with slightly later time tags."""

    def change(world: World, case: Case, _: np.random.Generator) -> Case:
        copies = later(case, np.full(len(case.observations), shift_s)).observations
        return replace(case, observations=Observations.concatenate([case.observations, copies]))

    return change


def made_again(case: Case, names: str, **columns: np.ndarray) -> Case:
    """Return the case with observations from some columns of its own and from others, which are checked."""
    stated = {name: getattr(case.observations, name) for name in names.split()}
    return replace(case, observations=Observations.from_columns(**stated, **columns))


def single_precision(world: World, case: Case, _: np.random.Generator) -> Case:
    """Round values to single precision."""
    names = "epoch links sigma_m link tag kind pressure_hpa temperature_k relative_humidity wavelength_um"
    names += " uplink_hz count_s modulus_m ramped ramps"
    return made_again(case, names, value_m=case.observations.value_m.astype(np.float32))


def wrong_weather(factor: float) -> Change:
    """Multiply recorded pressures, as of another unit."""
    names = "epoch links value_m sigma_m link tag kind temperature_k relative_humidity wavelength_um"
    return lambda world, case, _: made_again(
        case, names, pressure_hpa=factor * case.observations.pressure_hpa
    )


def doppler_offset(fraction: float) -> Change:
    """Add the effect of a relative frequency offset to the Doppler of a station."""
    return added(
        lambda world, table: (
            fraction * C_M_S * np.nan_to_num(table.count_s) * rows_of(table, world.station, "doppler")
        )
    )


def half_count(world: World, case: Case, _: np.random.Generator) -> Case:
    """State half of the count interval of Doppler."""
    return with_columns(case, count_s=0.5 * case.observations.count_s)


def cycle_slips(world: World, case: Case, random: np.random.Generator) -> Case:
    """Change a twentieth of the counts by one to three cycles of the carrier."""
    observations = case.observations
    rows = (observations.types() == "doppler") & (random.random(len(observations)) < 0.05)
    cycles = random.integers(1, 4, len(observations)) * random.choice([-1, 1], len(observations))
    return with_values(case, 1e-6 * observations.wavelength_um * cycles * rows)


def wrong_turnaround(world: World, case: Case, _: np.random.Generator) -> Case:
    """Compute Doppler in X band by the turnaround ratio of X up and S down, 240/749 for 880/749."""
    table = case.observations
    rows, count_m = table.types() == "doppler", C_M_S * table.count_s
    wavelength_um = np.where(rows, 1e6 * C_M_S * 749.0 / 240.0 / table.uplink_hz, table.wavelength_um)
    value_m = np.where(rows, count_m - 880.0 / 240.0 * (count_m - table.value_m), table.value_m)
    return with_columns(case, value_m=value_m, wavelength_um=wavelength_um)


# Changes of the study


def of_study(difference: Callable[[World, Study], Study]) -> Change:
    """Change the study."""
    return lambda world, case, _: replace(case, study=difference(world, case.study))


def displaced(east_m: float, up_m: float) -> Change:
    """Displace a station in the catalogue, in units of the world's length."""

    def difference(world: World, study: Study) -> Study:
        station = study.catalogue.get(world.station)
        east, _, up = rot_itrf_to_enu(station.itrf_m)
        size_m = world.length_m if world.name == "llr" else 1.0
        itrf_m = station.itrf_m + size_m * (east_m * east + up_m * up)
        return replace(study, catalogue=study.catalogue.with_station(replace(station, itrf_m=itrf_m)))

    return of_study(difference)


def all_stations_higher(up_m: float) -> Change:
    """Raise all stations, as by heights above another surface."""

    def change(world: World, case: Case, _: np.random.Generator) -> Case:
        catalogue: StationCatalogue = case.study.catalogue
        for name in dict.fromkeys(name for link in case.observations.links for name in link.stations):
            station = catalogue.get(name)
            itrf_m = station.itrf_m + up_m * rot_itrf_to_enu(station.itrf_m)[2]
            catalogue = catalogue.with_station(replace(station, itrf_m=itrf_m))
        return replace(case, study=replace(case.study, catalogue=catalogue))

    return change


def higher_prior(error_m: float) -> Change:
    """Change the a-priori height."""
    return of_study(lambda _, study: with_height_prior(study, study.estimate.height_prior.height_m + error_m))


def without_term(term: str) -> Change:
    """Switch a term of the model off."""
    return of_study(
        lambda _, study: replace(
            study, model=replace(study.model, off=tuple(dict.fromkeys((*study.model.off, term))))
        )
    )


def ephemeris(name: str) -> Change:
    """Fit with another ephemeris; positions of reflectors keep their axes."""
    return of_study(
        lambda _, study: replace(study, model=replace(study.model, ephemeris=name, libration=name))
    )


def with_forces(study: Study, **forces) -> Study:
    """Return a study of an orbit with other forces."""
    target = study.target
    return replace(study, target=replace(target, forces=replace(target.forces, **forces)))


def fewer_harmonics(degree: int) -> Change:
    """Truncate the gravity field of the fit."""
    return of_study(
        lambda _, study: with_forces(study, gravity=GravityField.open("GRGM660PRIM", degree=degree))
    )


def solar_pressure(factor: float) -> Change:
    """Multiply the coefficient of solar pressure in the fit."""
    return of_study(
        lambda world, study: with_forces(
            study, radiation_m2_kg=factor * world.truth.target.forces.radiation_m2_kg
        )
    )


# Differences of the world from the study


def of_world(difference: Callable[[Study], Study]) -> Change:
    """Add the effect of a difference of the true world to the values."""

    @cache
    def effect_m(world: World) -> np.ndarray:
        return world.values_m(difference(world.truth)) - world.value_m

    return lambda world, case, _: with_values(case, effect_m(world))


def by_parameter(name: str, size: float) -> Change:
    """Add the effect of errors of the parameters whose names begin with `name`, each of some a-priori sigmas."""

    def errors_m(world: World, _: Observations) -> np.ndarray:
        names, effects_m = world.errors
        columns = [k for k, item in enumerate(names) if item.startswith(name)]
        return size * effects_m[:, columns].sum(axis=1)

    return added(errors_m)


def _with_electrons(study: Study) -> Study:
    off = tuple(term for term in study.model.off if term != "ionosphere")
    return replace(study, model=replace(study.model, off=off, tec_tecu=80.0))


def _with_manoeuvre(study: Study) -> Study:
    epoch = study.target.epoch.shifted(7200.0)
    return with_forces(study, impulses=(Impulse("manoeuvre", epoch, (0.0, 0.02, 0.0)),))


_STATION = "{station}"
_RANGING = "{station}|KASHI"
_CLOCK = "{station}|clock"
_TAGS = r"time tag|time bias|\bTAI\b|\bTDB\b"
_ALL_RANGES = "transponder|all ranges|common|range bias"
_SIGMA = "stated sigma|sigmas? (are|is)|times their sigmas|larger than stated|smaller than stated|noise added"
_OUTLIERS = "outlier|rejected|left out"

_ADVICE = re.compile(r"look for [^|]*|give better ones [^|]*")
"""Advice that follows on any misfit; it names no culprit."""

_ALTERNATIVES = "the data cannot exclude that"

FAULTS: tuple[Fault, ...] = (
    Fault("station 30 m long", _STATION, station_offset(30.0), (*TRACKING,)),
    Fault("station 300 m long", _STATION, station_offset(300.0), (*TRACKING,)),
    Fault("station 1 km long", _STATION, station_offset(1000.0), (*TRACKING,)),
    Fault("ranges of a station 30 m long", "KASHI", range_offset(30.0, station_ranges), ("vlbi",)),
    Fault("ranges of a station 300 m long", "KASHI", range_offset(300.0, station_ranges), ("vlbi",)),
    Fault("two stations off by 30 m", "{station}|{partner}", two_station_offsets, (*TRACKING,)),
    Fault("ranges of half a series 300 m long", _RANGING, range_offset(300.0, second_half), TRACKING),
    Fault("run of ranges 50 m long", _RANGING, range_offset(50.0, short_run), TRACKING),
    Fault("pass 30 m long", _RANGING, range_offset(30.0, first_pass), TRACKING),
    Fault("pass 300 km long", _RANGING, range_offset(3e5, first_pass), RADIO),
    Fault("clock 5 ns", _CLOCK, clock_offset(5e-9), ("vlbi",)),
    Fault("clock 500 ns", _CLOCK, clock_offset(5e-7), ("three-way", "vlbi")),
    Fault("clock 1 ms", _CLOCK, clock_offset(1e-3), ("vlbi",)),
    Fault("clock rate 1e-12", _CLOCK, clock_offset(0.0, rate=1e-12), ("three-way", "vlbi")),
    Fault("clock jump 5 ns", _CLOCK, clock_offset(0.0, jump_s=5e-9), ("vlbi",)),
    Fault("clock jump 200 ns", _CLOCK, clock_offset(0.0, jump_s=2e-7), ("three-way",)),
    Fault("tags of a station 1 ms late", "{station}|" + _TAGS, tags(1e-3, of_station=True), ALL),
    Fault("tags of a station 0.1 s late", "{station}|" + _TAGS, tags(0.1, of_station=True), ALL),
    Fault("tags of a station 1 s late", "{station}|" + _TAGS, tags(1.0, of_station=True), ALL),
    Fault("tags 0.1 s late", _TAGS, tags(0.1), ALL),
    Fault("tags 1 s late", _TAGS, tags(1.0), ALL),
    Fault("tags in TAI", _TAGS, tags_as(utc_to_tai), ALL),
    Fault("tags in TDB", _TAGS, tags_as(utc_to_tt), ALL),
    Fault("tags one day late", _TAGS + "|epoch|one day", tags(86400.0), (*TRACKING,)),
    Fault("transmit for receive tag", _TAGS + "|transmi", transmit_for_receive, (*RADIO[:2], "llr", "grail")),
    Fault("transponder delay 100 ns", _ALL_RANGES, range_offset(100e-9 * C_M_S, of_kind("range")), RADIO),
    Fault("station 80 m east", _STATION, displaced(80.0, 0.0), ALL),
    Fault("station 80 m up", _STATION, displaced(0.0, 80.0), ALL),
    Fault("station 1 km east", _STATION, displaced(1000.0, 0.0), ALL),
    Fault("station 1 km up", _STATION, displaced(0.0, 1000.0), ALL),
    Fault(
        "all stations 30 m up", "positions? of|station position", all_stations_higher(30.0), (*RADIO, "grail")
    ),
    Fault("stations exchanged", "{station}|{partner}|exchang", exchanged_stations(), (*RADIO, "llr")),
    Fault(
        "VLBI stations exchanged",
        "SESHAN25|KUNMING|exchang",
        exchanged_stations("SESHAN25", "KUNMING"),
        ("vlbi",),
    ),
    Fault("wrong station in a pass", "{station}|{partner}", wrong_station_in_pass, ("dsn", "grail")),
    Fault("link reversed", "{station}|revers", reversed_link, ("three-way", "vlbi")),
    Fault(
        "sign reversed",
        r"\bsign\b|revers",
        multiplied(-2.0, lambda _, table: table.types() != "range"),
        ("dsn", "vlbi", "grail"),
    ),
    Fault(
        "sign reversed in a pass",
        r"\bsign\b|revers",
        multiplied(-2.0, longest_doppler_pass),
        ("dsn", "grail"),
    ),
    Fault("values in km", r"\bkm, not m|unit|plausible", multiplied(1e-3 - 1.0, of_kind(None)), ALL),
    Fault("ranges halved", "half|halv|one-way|twice", multiplied(-0.5, of_kind("range")), TRACKING),
    Fault(
        "ranges of a station halved",
        _RANGING + "|half|halv|one-way",
        multiplied(-0.5, station_ranges),
        TRACKING,
    ),
    Fault("5 % outliers", _OUTLIERS, outliers(0.05, 30.0), ALL),
    Fault("40 % outliers of a station", _STATION, outliers(0.4, 30.0, of_station=True), ALL),
    Fault("sigmas of a station 100 times too small", _STATION, sigmas(0.01, of_station=True), ALL),
    Fault("sigmas of a station 5 times too small", _STATION, sigmas(0.2, of_station=True), ALL),
    Fault("sigmas of a station 10 times too large", _STATION, sigmas(10.0, of_station=True), ALL),
    Fault("sigmas 100 times too small", _SIGMA, sigmas(0.01), ALL),
    Fault("sigmas 5 times too small", _SIGMA, sigmas(0.2), ALL),
    Fault("sigmas 10 times too large", _SIGMA, sigmas(10.0), ALL),
    Fault("height prior 300 m off", "height|a-priori position", higher_prior(300.0), ("three-way", "vlbi")),
    Fault("height prior 50 m off", "height|a-priori position", higher_prior(50.0), ("three-way", "vlbi")),
    Fault("height prior 663 m off", "height|a-priori position", higher_prior(-663.0), ("three-way", "vlbi")),
    Fault("duplicates 1 us apart", "duplicat|twice|repeat|cop(y|ies)", duplicates(1e-6), ALL),
    Fault("duplicates 1 ms apart", "duplicat|twice|repeat|cop(y|ies)", duplicates(1e-3), ALL),
    Fault("zenith delays 0.5 m off", "zenith|tropos", by_parameter("zenith_delay", 0.5 / 0.03), RADIO),
    Fault("solar maximum without ionosphere", "electron|ionos|plasma", of_world(_with_electrons), RADIO),
    Fault("troposphere switched off", "zenith|tropos", without_term("troposphere"), TRACKING),
    Fault("relativity switched off", "shapiro|relativ|gravitational", without_term("shapiro"), TRACKING),
    Fault("tides switched off", "tide|station", without_term("solid_earth_tide"), TRACKING),
    Fault("wrong ephemeris", "moon|ephemeris|librat", ephemeris("DE440"), RADIO),
    Fault(
        "UT1 0.05 s off", "ut1|earth orientation|rotation|time", by_parameter("ut1", 5e3), (*RADIO, "grail")
    ),
    Fault(
        "scale of a station 1e-7",
        _STATION + "|scale",
        multiplied(1e-7, of_kind(None, of_station=True)),
        (*RADIO, "grail"),
    ),
    Fault("single precision", "precision|float32|round", single_precision, ALL),
    Fault("pressure in kPa", "pressure", wrong_weather(0.1), ("llr",)),
    Fault("pressure in mmHg", "pressure|zenith|tropos", wrong_weather(0.75006), ("llr",)),
    Fault("pressure in Pa", "pressure", wrong_weather(100.0), ("llr",)),
    Fault("wrong reflector in a night", "apollo15|apollo14", wrong_target_in_night, ("llr",)),
    Fault("Doppler of a station off by 1e-12", _STATION, doppler_offset(1e-12), ("dsn", "grail")),
    Fault("Doppler of a station off by 1e-10", _STATION, doppler_offset(1e-10), ("dsn", "grail")),
    Fault(
        "half of the count interval",
        "count interval|scale|doppler values .* twice",
        half_count,
        ("dsn", "grail"),
    ),
    Fault("cycle slips", "slip|" + _OUTLIERS, cycle_slips, ("dsn", "grail")),
    Fault(
        "wrong uplink frequency",
        "scale|frequenc|uplink",
        multiplied(1e-3, of_kind("doppler")),
        ("dsn", "grail"),
    ),
    Fault("wrong turnaround ratio", "turnaround", wrong_turnaround, ("dsn", "grail")),
    Fault("gravity truncated", "gravity|harmonic|degree|forces", fewer_harmonics(10), ("grail",)),
    Fault("manoeuvre not modelled", "manoeuvre", of_world(_with_manoeuvre), ("grail",)),
    Fault("solar pressure 10 times", "radiation|solar pressure", solar_pressure(10.0), ("grail",)),
)
NO_FAULT = Fault("no fault", "(?!)", lambda world, case, random: case, ALL)

OUTCOMES = {
    "right": "converged, within 3.4 sigmas",
    "culprit first": "converged, beyond 3.4 sigmas, the culprit is named first",
    "culprit among others": "converged, beyond 3.4 sigmas, the culprit is named after others",
    "mentioned": "converged, beyond 3.4 sigmas, the culprit is mentioned in notes or warnings only",
    "not revealed": "converged, beyond 3.4 sigmas, the card states that such an error may be undetected",
    "wrong culprit": "converged, beyond 3.4 sigmas, others are named",
    "silent": "converged, beyond 3.4 sigmas, unnamed and unmentioned",
    "refused, culprit first": "exit status 2 or 3, the culprit is named first",
    "refused, culprit among others": "exit status 2 or 3, the culprit is named after others or in the message",
    "refused, wrong culprit": "exit status 2 or 3, others are named",
    "refused, unnamed": "exit status 2 or 3, nothing is named",
}


@dataclass(frozen=True)
class Outcome:
    """Outcome of a fit with a fault."""

    world: str
    fault: str
    seed: int
    outcome: str  # of OUTCOMES
    status: str
    error_m: float
    sigmas: float
    named: tuple[str, ...]  # sentences of findings, in order
    place: int  # index of the culprit among findings and their alternatives; -1 if it is not named
    text: str  # message, warnings and notes

    @property
    def exit(self) -> int:
        """Exit status of the command line."""
        return {"converged": 0, "refused": 2}.get(self.status, 3)


def run(world: World, fault: Fault, seed: int) -> Outcome:
    """Fit a realization of a world with a fault."""
    pattern = fault.pattern(world)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            case = fault.change(world, world.draw(seed), generator(seed, fault.name))
            solution = radioloc.locate(case.study, case.observations)
        except RadiolocError as error:
            outcome = "refused, culprit first" if pattern.search(str(error)) else "refused, unnamed"
            return Outcome(
                world.name, fault.name, seed, outcome, "refused", np.nan, np.nan, (), -1, str(error)
            )
    named = tuple(str(item) for item in solution.consistency.findings)
    notes = " | ".join([solution.message, *solution.notes, *(str(item.message) for item in caught)])
    notes = _ADVICE.sub("", notes)
    distances = world.distances(solution)
    error_m, size = max(distances.values(), key=lambda pair: pair[1])
    limit = np.sqrt(chi2.ppf(LIMIT_PROBABILITY ** (1.0 / len(distances)), 3))
    # Causes that the data cannot separate from the first one of a finding come after it.
    causes = [cause for text in named for cause in text.split(_ALTERNATIVES)]
    place = next((k for k, cause in enumerate(causes) if pattern.search(cause)), -1)
    outcome = _outcome(solution.converged, size <= limit, named, place, bool(pattern.search(notes)))
    if outcome == "silent" and pattern.search(_unrevealed(solution)):
        outcome = "not revealed"
    return Outcome(
        world.name, fault.name, seed, outcome, solution.status.value, error_m, size, named, place, notes
    )


def _unrevealed(solution: radioloc.Solution) -> str:
    """Return the undetected errors, and those that the data do not reveal, as the card states them."""
    return re.split(r"\n\w", str(solution).partition("of undetected errors")[2])[0]


def _outcome(converged: bool, is_within: bool, named: tuple[str, ...], place: int, mentioned: bool) -> str:
    """Return the class of a fit."""
    if converged and is_within:
        return "right"
    if place == 0:
        outcome = "culprit first"
    elif place > 0 or (named and mentioned):
        outcome = "culprit among others"
    elif named:
        outcome = "wrong culprit"
    elif mentioned:
        outcome = "mentioned" if converged else "culprit first"
    else:
        return "silent" if converged else "refused, unnamed"
    return outcome if converged else f"refused, {outcome}"
