"""SPICE kernels: a lander as an SPK and a frames kernel with the Moon's axes and its horizon; an orbit as an SPK.

Source: NAIF's *SPK Required Reading*.
"""

from __future__ import annotations

import os
import re
import shutil
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from radioloc.constants import J2000_JD, SECONDS_PER_DAY
from radioloc.dynamics import Orbit
from radioloc.ephemeris.constants import CONSTANTS
from radioloc.errors import InputError
from radioloc.quantities import accepts_quantities
from radioloc.results.tables import SolutionLike, position_of, single_content
from radioloc.text_files import replaced_file, require_ending, scratch_folder, to_ascii
from radioloc.vectors import Floats

FIRST_SITE = 301001
"""NAIF code of the first site on the Moon; those of the Earth begin with 399001."""
_MOON = 301
_PRINCIPAL_AXES = {"PA_DE421": 31006, "PA_DE440": 31008}  # NAIF's frame codes in its binary PCKs of the Moon
_MEAN_EARTH = {"PA_DE421": ("MOON_ME_DE421", 31007), "PA_DE440": ("MOON_ME_DE440_ME421", 31009)}
_PCK_CLASS, _FIXED_CLASS = 2, 4  # SPICE's classes of frames
_HALF_SPAN_S = 3.2e9  # before and after J2000: 1898 to 2101
_MAX_SEGMENT_NAME = 40  # characters of the identifier of a segment
_MAX_FRAME_NAME = 21  # SPICE's variable FRAME_name_TOPO has at most 32 characters
M_PER_KM = 1000.0
_DEGREE = 11
_MAX_STEP_S = 600.0


def write_spice(path: str | Path, solution: SolutionLike, *, body: int = FIRST_SITE) -> tuple[Path, Path]:
    """Write an SPK with a lander's place, and beside it a frames kernel that SPICE needs to read it.

    Parameters
    ----------
    path : path-like
        The SPK, ``.bsp``. The frames kernel has the same name and ends in ``.tf``: the body's name and code, the
        principal and mean-Earth axes of the ephemeris, and ``NAME_TOPO``, x to the north, y to the west and z up.
    solution : Solution, other result with a position, or mapping
        Result with the position; a mapping is the content of ``solution.json``.
    body : int
        NAIF code of the lander.

    Returns
    -------
    tuple of Path
        The SPK and the frames kernel. Beside these, SPICE needs an ephemeris and the binary PCK of its Moon.

    Raises
    ------
    InputError
        The solution has no position in axes that NAIF defines, the path does not end in .bsp, or `body` is the code of
        a body of NAIF.

    Notes
    -----
    The mean-Earth axes are those of NAIF's frames kernels of the same names, by the same three constant angles.

    Examples
    --------
    >>> import radioloc
    >>> solution = radioloc.locate(radioloc.read_study("examples/apollo15/apollo15.toml"))
    >>> [file.name for file in radioloc.io.write_spice("apollo15.bsp", solution)]
    ['apollo15.bsp', 'apollo15.tf']
    """
    import spiceypy

    content = single_content([solution])
    spk, frames = Path(path), Path(path).with_suffix(".tf")
    require_ending(spk, (".bsp",))
    if isinstance(body, bool) or not isinstance(body, int) or 0 <= body < 1000:
        raise InputError(
            f"body: expected a NAIF code of a lander, such as {FIRST_SITE} or a negative one, got {body!r}"
        )
    pa = position_of(content)["pa"]
    if pa["frame"] not in _PRINCIPAL_AXES:
        raise InputError(
            f"{content['name']}: expected axes {' or '.join(_PRINCIPAL_AXES)}, which SPICE has, got {pa['frame']}"
        )
    content = {**content, "name": to_ascii(content["name"], _MAX_SEGMENT_NAME).strip() or "lander"}
    state = [pa[f"{axis}_m"] / M_PER_KM for axis in "xyz"] + [0.0] * 3
    # The frames kernel is replaced last, after the SPK is complete.
    with replaced_file(frames) as temporary, _new_spk(spk) as handle:
        temporary.write_text(_frames(content, body), encoding="ascii")
        with spice_path(temporary) as name:
            spiceypy.furnsh(name)
            try:
                axes, span = f"MOON_{pa['frame']}", [-_HALF_SPAN_S, _HALF_SPAN_S]
                spiceypy.spkw09(handle, body, _MOON, axes, *span, content["name"], 1, 2, [state] * 2, span)
            finally:
                spiceypy.unload(name)
    return spk, frames


def _frames(content: Mapping[str, Any], body: int) -> str:
    """Return the text of the frames kernel."""
    pa, me = content["position"]["pa"], content["position"]["me"]
    name = (
        re.sub(r"[^A-Z0-9]+", "_", content["name"].upper()).strip("_")[:_MAX_FRAME_NAME].strip("_")
        or "LANDER"
    )
    axes, number = f"MOON_{pa['frame']}", _PRINCIPAL_AXES[pa["frame"]]
    mean, mean_number = _MEAN_EARTH[pa["frame"]]
    about_x, about_y, about_z = CONSTANTS[pa["frame"].partition("_")[2]].pa_to_me_arcsec
    # SPICE's angles of a fixed frame turn from it to the frame that it is relative to.
    horizon = (-me["longitude_deg"], me["latitude_deg"] - 90.0, 180.0)
    topo_number = 1_400_000 + abs(body) % 600_000  # in the range that NAIF reserves for users
    blocks = [
        [f"NAIF_BODY_NAME += '{name}'", f"NAIF_BODY_CODE += {body}"],
        _frame(axes, number, _PCK_CLASS),
        _frame(mean, mean_number, _FIXED_CLASS)
        + _fixed(mean_number, axes, (-about_z, -about_y, -about_x), (3, 2, 1), "ARCSECONDS"),
        _frame(f"{name}_TOPO", topo_number, _FIXED_CLASS, body)
        + _fixed(topo_number, mean, horizon, (3, 2, 3), "DEGREES"),
    ]
    data = "\n\n".join("\n".join(block) for block in blocks)
    return (
        "KPL/FK\n\n"
        f"{content['name']}: {me['longitude_deg']:.8f} deg east, {me['latitude_deg']:.8f} deg north,\n"
        f"{me['height_m']:.3f} m above the sphere of 1737.4 km, in {me['frame']}.\n"
        f"{name}_TOPO has x to the north, y to the west and z up there. Load beside this an\n"
        f"ephemeris and the binary PCK of {axes}.\n\n"
        f"\\begindata\n\n{data}\n\n\\begintext\n"
    )


def _frame(name: str, number: int, kind: int, center: int = _MOON) -> list[str]:
    return [
        f"FRAME_{name} = {number}",
        f"FRAME_{number}_NAME = '{name}'",
        f"FRAME_{number}_CLASS = {kind}",
        f"FRAME_{number}_CLASS_ID = {number}",
        f"FRAME_{number}_CENTER = {center}",
    ]


def _fixed(
    number: int, relative: str, angles: tuple[float, float, float], axes: tuple[int, int, int], unit: str
) -> list[str]:
    return [
        f"TKFRAME_{number}_RELATIVE = '{relative}'",
        f"TKFRAME_{number}_SPEC = 'ANGLES'",
        f"TKFRAME_{number}_UNITS = '{unit}'",
        f"TKFRAME_{number}_AXES = ( {', '.join(map(str, axes))} )",
        f"TKFRAME_{number}_ANGLES = ( {', '.join(repr(float(angle)) for angle in angles)} )",
    ]


@accepts_quantities
def write_orbit_spk(
    path: str | Path, orbit: Orbit | Sequence[Orbit], body: int, *, step_s: float = 15.0
) -> Path:
    """Write an orbit, or several that follow each other, as an SPK of type 13, with a negative NAIF code `body`.

    Hermite polynomials of degree 11 go through states at equal steps, 600 s at most. At 15 s the error is a micrometre
    in a low orbit with a field to degree 150.
    """
    import spiceypy

    if isinstance(body, bool) or not isinstance(body, int) or not -(2**31) < body < 0:
        raise InputError(f"body: expected a negative NAIF code of a spacecraft, such as -177, got {body!r}")
    with _new_spk(path) as handle:
        for part, times_s in orbit_parts(orbit, step_s):
            midnight_s = float((part.epoch.jd[0] - J2000_JD) * SECONDS_PER_DAY)
            of_day_s = float(part.epoch.fraction[0] * SECONDS_PER_DAY)
            et_s = midnight_s + of_day_s + times_s
            states = states_km(part, times_s)
            # A float of seconds since J2000 is off by up to 0.06 us: 0.1 mm along a low orbit.
            rest_s = (midnight_s - et_s) + of_day_s + times_s
            states[:, :3] -= states[:, 3:] * rest_s[:, None]
            count = len(et_s)
            degree = min(_DEGREE, 2 * count - 1)
            segment = (body, _MOON, "J2000", et_s[0], et_s[-1], to_ascii(part.name, _MAX_SEGMENT_NAME))
            spiceypy.spkw13(handle, *segment, degree, count, states.tolist(), et_s.tolist())
    return Path(path)


@contextmanager
def _new_spk(path: str | Path) -> Iterator[int]:
    """Yield the handle of a new SPK, which replaces an existing file once it is complete."""
    import spiceypy
    from spiceypy.utils.exceptions import SpiceyError

    # SPICE cannot create files with long names, so it writes in a folder for temporary files.
    with replaced_file(path) as temporary, short_folder() as folder:
        new = folder / "new.bsp"
        try:
            handle = spiceypy.spkopn(str(new), "radioloc", 0)
            try:
                yield handle
            finally:
                spiceypy.dafcls(handle)
        except SpiceyError as error:
            raise InputError(f"{path} cannot be written by SPICE: {spice_message(error)}") from error
        shutil.copyfile(new, temporary)


def orbit_parts(orbit: Orbit | Sequence[Orbit], step_s: float) -> Iterator[tuple[Orbit, Floats]]:
    """Yield each part without a jump, and equally spaced times in it from its epoch, both ends included."""
    if not 0.0 < step_s <= _MAX_STEP_S:
        raise InputError(f"step_s: expected above 0 and at most {_MAX_STEP_S:.0f} s, got {step_s!r}")
    for part in (orbit,) if isinstance(orbit, Orbit) else orbit:
        for leg in part.legs:
            first_s, last_s = leg.span_s
            yield (
                replace(part, legs=(leg,)),
                np.linspace(first_s, last_s, 2 + int((last_s - first_s) / step_s)),
            )


def states_km(orbit: Orbit, times_s: Floats) -> Floats:
    """Return states at times from the orbit's epoch, km and km/s, shape (n, 6)."""
    return np.hstack(orbit.states(orbit.epoch.shifted(times_s))) / M_PER_KM


MAX_PATH_BYTES = 255  # of a file name in SPICE


@contextmanager
def short_folder() -> Iterator[Path]:
    """Make a folder for temporary files whose paths SPICE can open."""
    with scratch_folder() as folder:
        if len(os.fsencode(folder)) > MAX_PATH_BYTES // 2:
            raise InputError(
                f"the folder for temporary files, {tempfile.gettempdir()}: expected a path of at most "
                f"{MAX_PATH_BYTES // 2} bytes, as SPICE opens no longer ones; set TMPDIR to another"
            )
        yield folder


@contextmanager
def spice_path(path: Path) -> Iterator[str]:
    """Give the name under which SPICE opens a file: its path, or a short link to it where that is too long."""
    if len(os.fsencode(path)) <= MAX_PATH_BYTES:
        yield str(path)
        return
    with short_folder() as folder:
        link = folder / f"kernel{path.suffix[:10]}"
        link.symlink_to(path.absolute())
        yield str(link)


def spice_message(error: Exception) -> str:
    """Return the message of a SPICE error in one line."""
    text = getattr(error, "long", "") or getattr(error, "short", "") or str(error)
    return " ".join(text.split())
