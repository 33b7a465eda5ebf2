"""SPK files with trajectories made for tests: a low lunar orbit, one about the Earth, a lander standing still."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import spiceypy

from radioloc.ephemeris import CONSTANTS, Ephemeris, LunarOrientation
from radioloc.lunar import LunarPosition, rot_icrf_to_pa
from radioloc.lunar.frames import rot_icrf_to_pa_rate
from radioloc.measurements.link import Link
from radioloc.measurements.measurement_type import TIME_TAGS
from radioloc.measurements.observations import Observations
from radioloc.measurements.registry import KINDS
from radioloc.time import Epochs, tai_to_utc

ORBITER = -85
START_S, STOP_S = 660139200.0, 660139200.0 + 36 * 3600.0
"""TDB seconds since J2000, from 2020-12-02 00:00 on."""

States = Callable[[np.ndarray], np.ndarray]
"""From TDB seconds since J2000, shape (n,), to states in the ICRF, m and m/s, shape (n, 6)."""


def circular(
    radius_m: float, gm_m3_s2: float, inclination_deg: float = 85.0, node_deg: float = 40.0
) -> States:
    """Keplerian motion in a circle."""
    rate = np.sqrt(gm_m3_s2 / radius_m**3)
    i, node = np.radians([inclination_deg, node_deg])
    along = np.array([np.cos(node), np.sin(node), 0.0])
    across = np.array([-np.sin(node) * np.cos(i), np.cos(node) * np.cos(i), np.sin(i)])

    def states(et_s: np.ndarray) -> np.ndarray:
        angle = rate * (np.asarray(et_s) - START_S)[:, None]
        place = radius_m * (np.cos(angle) * along + np.sin(angle) * across)
        return np.hstack([place, radius_m * rate * (np.cos(angle) * across - np.sin(angle) * along)])

    return states


def low_lunar_orbit(ephemeris: Ephemeris, height_m: float = 100e3) -> States:
    """A circular orbit about the Moon: 1.6 m/s^2, 118 minutes."""
    return circular(1737.4e3 + height_m, ephemeris.constants.gm_moon_m3_s2)


def lander(libration: LunarOrientation, point_pa_m: np.ndarray) -> States:
    """A point fixed to the Moon, seen from the Moon's centre."""

    def states(et_s: np.ndarray) -> np.ndarray:
        angles, rates = libration.angles(Epochs.from_tdb_seconds(et_s))
        place, velocity = (
            np.einsum("nji,j->ni", rot, point_pa_m)
            for rot in (rot_icrf_to_pa(angles), rot_icrf_to_pa_rate(angles, rates))
        )
        return np.hstack([place, velocity])

    return states


def position_on_moon(
    place: tuple[float, float, float] = (-51.91637, 43.05784, -2570.25), ephemeris: str = "DE421"
) -> dict[str, Any]:
    """Longitude and latitude, deg, and height, m, as a ``solution.json`` has them."""
    constants = CONSTANTS[ephemeris]
    me = LunarPosition.from_selenographic(*place, frame=constants.me_frame)
    pa = me.to_axes("PA", constants)
    xyz = dict(zip(("x_m", "y_m", "z_m"), pa.xyz_m.tolist(), strict=True))
    angles = dict(zip(("longitude_deg", "latitude_deg", "height_m"), place, strict=True))
    return {
        "name": "lander 5",
        "position": {"pa": {"frame": pa.frame, **xyz}, "me": {"frame": me.frame, **angles}},
    }


def write_states(
    path: Path,
    states: States,
    *,
    spk_type: int = 13,
    step_s: float = 60.0,
    center: int = 301,
    body: int = ORBITER,
    spans_s: tuple[tuple[float, float], ...] = ((START_S, STOP_S),),
    frame: str = "J2000",
) -> Path:
    """Write states as an SPK of type 9 (Lagrange) or 13 (Hermite), one segment per span."""
    write = {9: spiceypy.spkw09, 13: spiceypy.spkw13}[spk_type]
    handle = spiceypy.spkopn(str(path), "trajectory made for a test", 0)
    try:
        for first, last in spans_s:
            et_s = np.arange(first, last + step_s, step_s)
            km = states(et_s) / 1e3
            write(handle, body, center, frame, first, last, "orbit", 11, len(et_s), km, et_s)
    finally:
        spiceypy.spkcls(handle)
    return path


def write_chebyshev(path: Path, states: States, *, length_s: float = 300.0, degree: int = 13) -> Path:
    """Write states as an SPK of type 3: Chebyshev series of position and velocity about the Moon."""
    starts = np.arange(START_S, STOP_S, length_s)
    nodes = np.cos(np.pi * (np.arange(degree + 1) + 0.5) / (degree + 1))
    records = []
    for start in starts:
        et_s = start + 0.5 * length_s * (1.0 + nodes)
        # Where the nodes are after their rounding to 0.1 microseconds, in which the orbiter moves 0.2 mm.
        at = (et_s - start) / (0.5 * length_s) - 1.0
        records.append(np.polynomial.chebyshev.chebfit(at, states(et_s) / 1e3, degree).T)
    handle = spiceypy.spkopn(str(path), "trajectory made for a test", 0)
    try:
        spiceypy.spkw03(
            handle, ORBITER, 301, "J2000", START_S, STOP_S, "orbit", length_s, len(starts), degree,
            np.ravel(records), START_S,
        )  # fmt: skip
    finally:
        spiceypy.spkcls(handle)
    return path


def tracking(
    path: str, tai: Epochs, tag: str = "receive", kind: str = "range", count_s: float = 60.0
) -> Observations:
    """Observations of any kind at epochs of TAI; the values mean nothing."""
    return Observations.from_columns(
        epoch=tai_to_utc(tai),
        links=[Link.from_path(path)],
        value_m=1.0,
        sigma_m=1.0,
        tag=TIME_TAGS.index(tag),
        kind=KINDS.index(kind),
        count_s=count_s if kind == "doppler" else np.nan,
    )
