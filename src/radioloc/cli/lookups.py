"""Commands that look something up rather than do a study; they start quickly, as each imports what it needs alone."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radioloc.cli.output import say, tell
from radioloc.cli.parser import DONE, NOT_CONVERGED, make_parser
from radioloc.earth.stations import Station, StationCatalogue
from radioloc.ephemeris import CONSTANTS, LunarOrientation
from radioloc.errors import InputError
from radioloc.extras import optional
from radioloc.kernels import add_kernel, added, registered
from radioloc.lunar import LunarPosition, rot_icrf_to_iau_moon, rot_icrf_to_pa
from radioloc.time import epochs_from_strings, tt_to_tdb, utc_to_tt

_IAU = "IAU_MOON"


def _doctor(options: argparse.Namespace) -> int:
    from radioloc.jobs.doctor import doctor

    found = doctor()
    tell(options, found, found.to_dict)
    return DONE if found.sound else NOT_CONVERGED


def _frames(options: argparse.Namespace) -> int:
    given = (options.longitude, options.latitude, options.height)
    if options.frame == _IAU and options.epoch is None:
        options.parser.error(f"{_IAU} moves against the other axes by some 100 m; give --epoch UTC")
    pa_to_iau = None if options.epoch is None else _rot_pa_to_iau(options.epoch)
    if options.frame == _IAU and pa_to_iau is not None:
        iau = LunarPosition.from_selenographic(
            *given, "PA_DE421"
        )  # the numbers are checked as of any other axes
        own = LunarPosition.from_cartesian(pa_to_iau.T @ iau.xyz_m, "PA_DE421")
    else:
        place = LunarPosition.from_selenographic(*given, options.frame)
        own = place.to_frame(options.frame)  # an error where these axes are not known
    found = {}
    for name in dict.fromkeys(
        name for one in CONSTANTS.values() for name in (f"PA_{one.name}", one.me_frame)
    ):
        with suppress(InputError):  # no angles lead there
            found[name] = own.to_frame(name)
    if pa_to_iau is not None and "PA_DE421" in found:
        found[_IAU] = LunarPosition.from_cartesian(pa_to_iau @ found["PA_DE421"].xyz_m, "PA_DE421")
    lines = []
    rows = []
    for name, there in found.items():
        longitude_deg, latitude_deg, height_m = there.selenographic
        x, y, z = there.xyz_m
        lines.append(
            f"{name:<9} {longitude_deg:14.9f} {latitude_deg:13.9f} deg {height_m:11.4f} m   "
            f"{x:14.4f} {y:14.4f} {z:14.4f} m"
        )
        numbers = {"longitude_deg": longitude_deg, "latitude_deg": latitude_deg, "height_m": height_m}
        rows.append({"frame": name, **numbers, "xyz_m": there.xyz_m})
    tell(options, "\n".join(lines), lambda: rows)
    return DONE


def _rot_pa_to_iau(epoch_utc: str) -> NDArray[np.float64]:
    """Rotation from the principal axes of DE421 to the IAU's mean rotation at an epoch, shape (3, 3)."""
    tdb = tt_to_tdb(utc_to_tt(epochs_from_strings([epoch_utc], "UTC")))
    angles_rad, _ = LunarOrientation.open("DE421").angles(tdb)
    rotation: NDArray[np.float64] = rot_icrf_to_iau_moon(tdb)[0] @ rot_icrf_to_pa(angles_rad)[0].T
    return rotation


def _stations(options: argparse.Namespace) -> int:
    found = StationCatalogue.default().find(options.name)
    if not found:
        raise InputError(
            f"no station has {options.name!r} in its name, complex or country; list all with radioloc stations"
        )
    lines = (_line_of(station) + _details_of(station) * bool(options.name) for station in found)
    tell(options, "\n".join(lines), lambda: [_of_a_station(station) for station in found])
    return DONE


def _line_of(station: Station) -> str:
    place = ", ".join(filter(None, (station.complex, station.country)))
    return (
        f"{station.name:<11} {station.kind:<5} {station.quality:<11} "
        + " ".join(f"{x:15.4f}" for x in station.itrf_m)
        + f" m  {'; '.join(filter(None, (', '.join(station.aliases), place)))}"
    )


def _details_of(station: Station) -> str:
    axis = "not known" if station.axis_offset_m is None else f"{station.axis_offset_m:g} m"
    moves = "" if station.velocity_known else ", velocity not known"
    return (
        f"\n{'':<11} {station.frame} at {station.epoch_year:g}, sigma {station.position_sigma_m:g} m{moves}; "
        + ("" if station.kind == "llr" else f"{station.mount}, axis offset {axis}; ")
        + station.source
    )


def _of_a_station(station: Station) -> dict[str, Any]:
    """What the catalogue says of a station, but for its ocean loading."""
    names = (field.name for field in fields(station))
    return {name: getattr(station, name) for name in names if name not in ("ocean_loading", "sigma_m")} | {
        "sigma_m": station.position_sigma_m
    }


def _kernels(options: argparse.Namespace) -> int:
    if (options.action == "add") != bool(options.files):
        options.parser.error("kernels add needs files, and only add takes them")
    known = [add_kernel(path) for path in options.files] or [*registered(), *added()]
    problems = [one.problem() if options.action == "verify" else "" for one in known]
    verdict = {"verify": "verified", "add": "added"}.get(options.action, "")
    lines = (
        problem
        or f"{one.name:<28} {one.kind} {one.ephemeris:<6} {one.start_tdb} to {one.end_tdb} {verdict}".rstrip()
        for one, problem in zip(known, problems, strict=True)
    )
    content = [
        asdict(one) | {"path": one.path, "ships": one in registered(), "problem": problem or None}
        for one, problem in zip(known, problems, strict=True)
    ]
    tell(options, "\n".join(lines), lambda: content)
    return NOT_CONVERGED if any(problems) else DONE


def _completion(options: argparse.Namespace) -> int:
    shtab = optional("shtab", "completion scripts are made by shtab, which is not installed;", "completion")
    parser = make_parser()
    for command in parser.commands.values():
        for action in command._actions:
            if action.type is Path:
                action.complete = shtab.DIRECTORY if action.metavar == "DIR" else shtab.FILE  # type: ignore[attr-defined]
    say(shtab.complete(parser, options.shell), end="")
    return DONE


COMMANDS: dict[str, Callable[[argparse.Namespace], int]] = {
    "doctor": _doctor,
    "frames": _frames,
    "kernels": _kernels,
    "stations": _stations,
    "completion": _completion,
}
"""Commands by name."""
