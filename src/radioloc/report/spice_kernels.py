"""A lander as SPICE kernels: an SPK with its place and a frames kernel with the Moon's axes and its horizon."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from radioloc.ephemeris.constants import CONSTANTS
from radioloc.errors import InputError
from radioloc.estimation.solution import Solution
from radioloc.report.image_solution import ImageSolution
from radioloc.text_files import replaced_file, write_text

FIRST_SITE = 301001
"""NAIF code of a first site on the Moon, as its ground sites of the Earth begin with 399001."""
_MOON = 301
_PRINCIPAL_AXES = {"PA_DE421": 31006, "PA_DE440": 31008}
"""Frame codes of NAIF's, which its binary PCKs of the Moon carry."""
_MEAN_EARTH = {"PA_DE421": ("MOON_ME_DE421", 31007), "PA_DE440": ("MOON_ME_DE440_ME421", 31009)}
_OF_A_PCK, _FIXED = 2, 4  # SPICE's classes of frames
_REACH_S = 3.2e9  # before and after J2000: 1898 to 2101
_LONGEST_NAME = 27  # SPICE's frames have names of at most 32, and _TOPO is added
_M_PER_KM = 1000.0


def write_spice(
    solution: Solution | ImageSolution | Mapping[str, Any], path: str | Path, *, code: int = FIRST_SITE
) -> tuple[Path, Path]:
    """Write an SPK with a lander's place, and beside it a frames kernel that SPICE needs to read it.

    Parameters
    ----------
    solution : Solution, ImageSolution or mapping
        Whose position is written; a mapping is what ``solution.json`` holds.
    path : path-like
        The SPK, ``.bsp``. The frames kernel has the same name and ends in ``.tf``: the body's name and code, the
        principal and mean-Earth axes of the ephemeris, and ``NAME_TOPO``, x to the north, y to the west and z up.
    code : int
        NAIF code of the lander.

    Returns
    -------
    tuple of Path
        The SPK and the frames kernel. Beside these, SPICE needs an ephemeris and the binary PCK of its Moon.

    Raises
    ------
    InputError
        The solution has no position or none that NAIF has axes for, the path does not end in .bsp, or the code is
        one of NAIF's own bodies'.

    Notes
    -----
    The mean-Earth axes are those of NAIF's frames kernels of the same names, by the same three constant angles.

    Examples
    --------
    >>> import radioloc
    >>> solution = radioloc.locate(radioloc.read_study("examples/apollo15/apollo15.toml"))
    >>> [file.name for file in radioloc.report.write_spice(solution, "apollo15.bsp")]
    ['apollo15.bsp', 'apollo15.tf']
    """
    import spiceypy

    content = solution if isinstance(solution, Mapping) else solution.to_dict()
    spk, frames = Path(path), Path(path).with_suffix(".tf")
    if spk.suffix != ".bsp":
        raise InputError(f"{spk}: an SPK ends in .bsp")
    if isinstance(code, bool) or not isinstance(code, int) or 0 <= code < 1000:
        raise InputError(
            f"code {code!r} is not one for a lander; use one such as {FIRST_SITE}, or a negative one"
        )
    if not content["position"]:
        raise InputError(
            f"{content['name']}: there is no fixed position to write; its trajectory is an SPK already"
        )
    pa = content["position"]["pa"]
    if pa["frame"] not in _PRINCIPAL_AXES:
        known = ", ".join(_PRINCIPAL_AXES)
        raise InputError(f"{content['name']}: SPICE has no frame for {pa['frame']}; it has some for {known}")
    write_text(frames, _frames(content, code))
    state = [pa[f"{axis}_m"] / _M_PER_KM for axis in "xyz"] + [0.0] * 3
    with replaced_file(spk) as temporary:
        temporary.unlink()
        spiceypy.furnsh(str(frames))
        try:
            handle = spiceypy.spkopn(str(temporary), "radioloc", 0)
            try:
                axes, span = f"MOON_{pa['frame']}", [-_REACH_S, _REACH_S]
                spiceypy.spkw09(
                    handle, code, _MOON, axes, *span, content["name"][:40], 1, 2, [state] * 2, span
                )
            finally:
                spiceypy.spkcls(handle)
        finally:
            spiceypy.unload(str(frames))
    return spk, frames


def _frames(content: Mapping[str, Any], code: int) -> str:
    """The text of the frames kernel."""
    pa, me = content["position"]["pa"], content["position"]["me"]
    name = re.sub(r"[^A-Z0-9]+", "_", content["name"].upper()).strip("_")[:_LONGEST_NAME] or "LANDER"
    axes, number = f"MOON_{pa['frame']}", _PRINCIPAL_AXES[pa["frame"]]
    mean, mean_number = _MEAN_EARTH[pa["frame"]]
    about_x, about_y, about_z = CONSTANTS[pa["frame"].partition("_")[2]].pa_to_me_arcsec
    # From the horizon to the mean-Earth axes: SPICE's angles of a fixed frame turn from it to what it is relative to.
    horizon = (-me["longitude_deg"], me["latitude_deg"] - 90.0, 180.0)
    topo_number = 1_400_000 + abs(code) % 600_000  # of the range that NAIF leaves to everyone
    blocks = [
        [f"NAIF_BODY_NAME += '{name}'", f"NAIF_BODY_CODE += {code}"],
        _frame(axes, number, _OF_A_PCK),
        _frame(mean, mean_number, _FIXED)
        + _fixed(mean_number, axes, (-about_z, -about_y, -about_x), (3, 2, 1), "ARCSECONDS"),
        _frame(f"{name}_TOPO", topo_number, _FIXED, code)
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
