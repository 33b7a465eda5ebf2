"""Commands that need no study: look-ups, and the starter study."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict, fields
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

from radioloc.cli.command import JSON, argument, command, study_tables, text_tables
from radioloc.cli.output import DONE, NOT_CONVERGED, finish, say, tell
from radioloc.errors import InputError
from radioloc.lazy import optional
from radioloc.text_files import require_ending, write_text

if TYPE_CHECKING:
    from radioloc.earth.stations import Station

STARTERS = ("lander", "reflector", "orbiter")
_SITE = (-51.8, 43.0, -2500.0)  # near Chang'e-5
_TARGET = """\
[{}]
frame = "ME_DE421"                        # mean-Earth axes, as maps have them
longitude_deg = {}                    # a-priori position, east longitude, within some tens of kilometres
latitude_deg = {}
height_m = {}                        # above the sphere of 1737.4 km
"""
_HEIGHT_PRIOR = "height_prior = {{ height_m = {}, sigma_m = 20.0 }}   # from a map; otherwise delete it\n"


@command(
    "new",
    argument(
        "kind",
        "target of the study, or keys: print the tables and keys of study files",
        choices=(*STARTERS, "keys"),
    ),
    argument("study STUDY.toml", "study file to write (default: the target's name)", Path, nargs="?"),
    argument("--out FILE", "the same as STUDY.toml", Path),
    argument(
        "--at LON LAT HEIGHT",
        "place of a lander: ME_DE421, m above 1737.4 km; repeat it for several landers",
        float,
        nargs=3,
        action="append",
    ),
    examples=("lander", "lander plan.toml --at 0 -89.5 1000", "orbiter my_orbiter.toml", "keys"),
)
def new(options: argparse.Namespace) -> int:
    """Write a commented starter study, with a plan of simulated tracking to try it."""
    if options.kind == "keys":
        say("\n".join(text_tables(study_tables())), end="")
        return DONE
    study: Path = options.out or options.study or Path(f"{options.kind}.toml")
    require_ending(study, (".toml",))
    if study.exists():
        raise InputError(f"{study}: the file exists; give another name")
    if options.at and options.kind != "lander":
        options.parser.error("--at is of a lander; edit the study of another target")
    data = study.with_suffix(".csv")
    places = options.at or [_SITE]
    template = files("radioloc.cli").joinpath("starters", f"{options.kind}.toml").read_text(encoding="utf-8")
    filled = {"{study}": study.name, "{data}": data.name, **_lander_tables(places)}
    for place, text in filled.items():
        template = template.replace(place, text)
    write_text(study, template)
    if not options.quiet:
        say(
            f"written to {study}; try it:\n  radioloc simulate {study} --out {data}\n  radioloc locate {study}"
        )
    return DONE


def _lander_tables(places: Sequence[Sequence[float]]) -> dict[str, str]:
    """Return the tables of landers and the height prior of a single one, by their places in the template."""
    from radioloc.lunar import LunarPosition

    for place in places:
        LunarPosition.from_selenographic(place[0], place[1], place[2])  # refuses impossible places
    if len(places) == 1:
        return {
            "{targets}": _TARGET.format("target", *places[0]),
            "{prior}": _HEIGHT_PRIOR.format(places[0][2]),
        }
    tables = (_TARGET.format(f"targets.lander{k}", *place) for k, place in enumerate(places, 1))
    return {"{targets}": "\n".join(tables), "{prior}": ""}


_IAU = "IAU_MOON"


@command("doctor", JSON, examples=("", "--json"))
def doctor(options: argparse.Namespace) -> int:
    """Check kernels, Earth orientation, leap seconds, the compiler's cache and optional packages."""
    from radioloc.jobs.doctor import doctor

    return finish(options, doctor())


@command(
    "frames",
    argument("longitude", "deg east", float),
    argument("latitude", "deg", float),
    argument("height", "above 1737.4 km, m", float),
    JSON,
    argument(
        "--frame FRAME",
        "axes of these numbers, such as PA_DE440; IAU_MOON with --epoch (default: ME_DE421)",
        default="ME_DE421",
    ),
    argument("--epoch UTC", "also show IAU_MOON, the IAU's mean rotation, at this epoch"),
    examples=("3.6285 26.1334 -1922.9", "-51.9162 43.0584 -2550.4 --epoch 2020-12-01T15:11"),
)
def frames(options: argparse.Namespace) -> int:
    """Convert a point on the Moon to the axes of each ephemeris."""
    from radioloc.ephemeris import CONSTANTS
    from radioloc.lunar import LunarPosition

    if options.frame == _IAU and options.epoch is None:
        options.parser.error(f"{_IAU} moves against the other axes by some 100 m; give --epoch UTC")
    rot_pa_to_iau = None if options.epoch is None else _rot_pa_to_iau(options.epoch)
    stated_in = "PA_DE421" if options.frame == _IAU else options.frame
    position = LunarPosition.from_selenographic(
        options.longitude, options.latitude, options.height, stated_in
    )
    position = position.to_frame(stated_in)  # raises an error if these axes are unknown
    if options.frame == _IAU and rot_pa_to_iau is not None:
        position = LunarPosition.from_cartesian(rot_pa_to_iau.T @ position.xyz_m, stated_in)
    converted = {}
    for name in dict.fromkeys(name for c in CONSTANTS.values() for name in (f"PA_{c.name}", c.me_frame)):
        with suppress(InputError):  # no angles lead there
            converted[name] = position.to_frame(name)
    if rot_pa_to_iau is not None and "PA_DE421" in converted:
        iau_m = rot_pa_to_iau @ converted["PA_DE421"].xyz_m
        converted[_IAU] = LunarPosition.from_cartesian(iau_m, "PA_DE421")
    line = "{:<9} {:14.9f} {:13.9f} deg {:11.4f} m   {:14.4f} {:14.4f} {:14.4f} m"
    lines = (line.format(name, *place.selenographic, *place.xyz_m) for name, place in converted.items())
    angles = ("longitude_deg", "latitude_deg", "height_m")
    rows = [
        {"frame": name, **dict(zip(angles, place.selenographic, strict=True)), "xyz_m": place.xyz_m}
        for name, place in converted.items()
    ]
    tell(options, "\n".join(lines), lambda: rows)
    return DONE


def _rot_pa_to_iau(epoch_utc: str) -> Any:
    """Return the rotation from the principal axes of DE421 to the IAU's mean rotation at an epoch, shape (3, 3)."""
    from radioloc.ephemeris import LunarOrientation
    from radioloc.lunar import rot_icrf_to_iau_moon, rot_icrf_to_pa
    from radioloc.time import epochs_from_strings, tt_to_tdb, utc_to_tt

    tdb = tt_to_tdb(utc_to_tt(epochs_from_strings([epoch_utc], "UTC")))
    angles_rad, _ = LunarOrientation.open("DE421").angles(tdb)
    return rot_icrf_to_iau_moon(tdb)[0] @ rot_icrf_to_pa(angles_rad)[0].T


@command(
    "stations",
    argument("name NAME", "a name, an alias, a complex, a country, or a part of one", nargs="?", default=""),
    JSON,
    examples=("", "kashi", "china --json"),
)
def stations(options: argparse.Namespace) -> int:
    """List the stations of the catalogue."""
    from radioloc.earth.stations import Station, StationCatalogue

    matches = StationCatalogue.default().find(options.name)
    if not matches:
        raise InputError(
            f"no station has {options.name!r} in its name, complex or country; list all with radioloc stations"
        )
    names = [field.name for field in fields(Station) if field.name not in ("ocean_loading", "sigma_m")]
    rows = [
        {name: getattr(station, name) for name in names} | {"sigma_m": station.position_sigma_m}
        for station in matches
    ]
    lines = (_station_text(station, details=bool(options.name)) for station in matches)
    tell(options, "\n".join(lines), lambda: rows)
    return DONE


def _station_text(station: Station, details: bool) -> str:
    """Return a line on a station, with details a second one."""
    place = ", ".join(filter(None, (station.complex, station.country)))
    itrf = " ".join(f"{x:15.4f}" for x in station.itrf_m)
    names = "; ".join(filter(None, (", ".join(station.aliases), place)))
    text = f"{station.name:<11} {station.kind:<5} {station.quality:<11} {itrf} m  {names}"
    if not details:
        return text
    axis = "not known" if station.axis_offset_m is None else f"{station.axis_offset_m:g} m"
    antenna = "" if station.kind == "llr" else f"{station.mount}, axis offset {axis}; "
    moves = "" if station.velocity_known else ", velocity not known"
    sigma = f"{station.frame} at {station.epoch_year:g}, sigma {station.position_sigma_m:g} m{moves}"
    return f"{text}\n{'':<11} {sigma}; {antenna}{station.source}"


@command(
    "kernels",
    argument(
        "action", "what to do (default: list)", nargs="?", choices=("list", "verify", "add"), default="list"
    ),
    argument("files FILE", "kernel files to add", Path, nargs="*"),
    JSON,
    examples=("", "verify", "add de430.bsp moon_pa_de430.bpc"),
)
def kernels(options: argparse.Namespace) -> int:
    """List the available kernels, verify their checksums, or add one."""
    from radioloc.kernels import registered
    from radioloc.kernels.files import add_kernel, added

    if (options.action == "add") != bool(options.files):
        options.parser.error("kernels add needs files, and only add takes them")
    available = [add_kernel(path) for path in options.files] or [*registered(), *added()]
    problems = [kernel.problem() if options.action == "verify" else "" for kernel in available]
    verdict = {"verify": "verified", "add": "added"}.get(options.action, "")
    lines = (
        problem
        or (
            f"{kernel.name:<28} {kernel.kind} {kernel.ephemeris:<6} {kernel.start_tdb} to {kernel.end_tdb} {verdict}"
        ).rstrip()
        for kernel, problem in zip(available, problems, strict=True)
    )
    content = [
        asdict(kernel) | {"path": kernel.path, "ships": kernel in registered(), "problem": problem or None}
        for kernel, problem in zip(available, problems, strict=True)
    ]
    tell(options, "\n".join(lines), lambda: content)
    return NOT_CONVERGED if any(problems) else DONE


@command(
    "completion",
    argument("shell", "the shell", choices=("bash", "zsh", "fish")),
    examples=("bash > ~/.local/share/bash-completion/completions/radioloc",),
)
def completion(options: argparse.Namespace) -> int:
    """Print a script by which a shell completes commands, options and files."""
    shtab = optional("shtab", "completion scripts are made by shtab, which is not installed;", "completion")
    for parser in options.program.commands.values():
        for action in parser._actions:
            if action.type is Path:
                action.complete = shtab.DIRECTORY if action.metavar == "DIR" else shtab.FILE
    say(shtab.complete(options.program, options.shell), end="")
    return DONE
