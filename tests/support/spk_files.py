"""SPK files of test trajectories: a low lunar orbit, an orbit about the Earth, a lander."""

import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import spiceypy
from arc_cases import observations

from radioloc.ephemeris import Ephemeris, LunarOrientation
from radioloc.lunar import rot_icrf_to_pa
from radioloc.lunar.frames import rot_icrf_to_pa_rate
from radioloc.measurements.observations import Observations
from radioloc.time import Epochs

ORBITER = -85
START_S, STOP_S = 660139200.0, 660139200.0 + 36 * 3600.0
"""TDB seconds since J2000, from 2020-12-02 00:00 on."""

States = Callable[[np.ndarray], np.ndarray]
"""From TDB seconds since J2000, shape (n,), to states in the ICRF, m and m/s, shape (n, 6)."""


def circular(
    radius_m: float, gm_m3_s2: float, inclination_deg: float = 85.0, node_deg: float = 40.0
) -> States:
    """Return Keplerian motion on a circle."""
    rate = np.sqrt(gm_m3_s2 / radius_m**3)
    i, node = np.radians([inclination_deg, node_deg])
    to_node = np.array([np.cos(node), np.sin(node), 0.0])
    across = np.array([-np.sin(node) * np.cos(i), np.cos(node) * np.cos(i), np.sin(i)])

    def states(et_s: np.ndarray) -> np.ndarray:
        angle = rate * (np.asarray(et_s) - START_S)[:, None]
        place = radius_m * (np.cos(angle) * to_node + np.sin(angle) * across)
        return np.hstack([place, radius_m * rate * (np.cos(angle) * across - np.sin(angle) * to_node)])

    return states


def low_lunar_orbit(ephemeris: Ephemeris, height_m: float = 100e3) -> States:
    """Return a circular orbit about the Moon: 1.6 m/s^2, 118 minutes."""
    return circular(1737.4e3 + height_m, ephemeris.constants.gm_moon_m3_s2)


def lander(libration: LunarOrientation, point_pa_m: np.ndarray) -> States:
    """Return the selenocentric motion of a point fixed to the Moon."""

    def states(et_s: np.ndarray) -> np.ndarray:
        angles, rates = libration.angles(Epochs.from_tdb_seconds(et_s))
        place, velocity = (
            np.einsum("nji,j->ni", rot, point_pa_m)
            for rot in (rot_icrf_to_pa(angles), rot_icrf_to_pa_rate(angles, rates))
        )
        return np.hstack([place, velocity])

    return states


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


TYPES = (1, 2, 3, 8, 9, 12, 13, 21)
"""Supported types of segments."""


def write_random(
    path: Path, spk_type: int, spans_s: list[tuple[float, float]], rng: np.random.Generator
) -> Path:
    """Write an SPK of a supported type, with random numbers in one segment per span.

    SPICE has no writers of the types 1 and 21: their words take the place of those of a segment of type 8.
    """
    handle = spiceypy.spkopn(str(path), "random numbers", 0)
    replaced = []
    for first_s, last_s in spans_s:
        segment = (ORBITER, 301, "J2000", first_s, last_s, "random")
        n = int(rng.integers(120, 300))
        degree = int(rng.choice([3, 7, 11]) if spk_type in (12, 13) else rng.integers(1, 12))
        step_s = (last_s - first_s) / (n - 1)
        epochs_s = first_s + step_s * np.arange(n)
        if spk_type in (9, 13):
            epochs_s[1:-1] += step_s * rng.uniform(-0.3, 0.3, n - 2)
        epochs_s[-1] = last_s
        states = np.cumsum(rng.normal(size=(n, 6)), axis=0)
        match spk_type:
            case 2 | 3:
                series = rng.normal(size=(n, 3 * (spk_type - 1), degree + 1)) * 0.5 ** np.arange(degree + 1)
                write = spiceypy.spkw02 if spk_type == 2 else spiceypy.spkw03
                write(handle, *segment, 1.01 * step_s, n, degree, series.ravel(), first_s)
            case 8 | 12:
                write = spiceypy.spkw08 if spk_type == 8 else spiceypy.spkw12
                write(handle, *segment, degree, n, states, first_s, step_s * (1.0 + 1e-9))
            case 9 | 13:
                write = spiceypy.spkw09 if spk_type == 9 else spiceypy.spkw13
                write(handle, *segment, degree, n, states, epochs_s)
            case 1 | 21:
                words = _difference_lines(15 if spk_type == 1 else 25, epochs_s, rng)
                n = -(-(len(words) - 4) // 6)
                spiceypy.spkw08(handle, *segment, 1, n, np.zeros((n, 6)), first_s, last_s - first_s)
                replaced.append(words)
    spiceypy.spkcls(handle)
    data = bytearray(path.read_bytes())
    summaries = (struct.unpack_from("<i", data, 76)[0] - 1) * 1024 + 24
    for k, words in enumerate(replaced):
        at = summaries + 40 * k + 16
        first = struct.unpack_from("<i", data, at + 16)[0]
        struct.pack_into("<i", data, at + 12, spk_type)
        struct.pack_into("<i", data, at + 20, first + len(words) - 1)
        data[(first - 1) * 8 : (first - 1 + len(words)) * 8] = words.astype("<f8").tobytes()
    path.write_bytes(data)
    return path


def _difference_lines(terms: int, finals_s: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return the words of a segment of type 1 (15 terms) or 21."""
    n = len(finals_s)
    lines = np.zeros((n, 4 * terms + 11))
    lines[:, 0] = finals_s
    lines[:, 1 : 1 + terms] = np.cumsum(rng.uniform(50.0, 100.0, (n, terms)), axis=1)
    lines[:, 1 + terms : 7 + 4 * terms] = rng.normal(size=(n, 6 + 3 * terms))
    lines[:, 7 + terms : 7 + 4 * terms] *= 1e-4
    lines[:, -3:] = rng.integers(1, terms, (n, 3))
    lines[:, -4] = lines[:, -3:].max(axis=1) + 1
    size = [] if terms == 15 else [terms]
    return np.concatenate([lines.ravel(), finals_s, finals_s[99::100], size, [n]])


def with_other_byte_order(data: bytes) -> bytes:
    """Return a little-endian SPK or binary PCK as a big-endian one."""
    out = bytearray(data)

    def swap(start: int, stop: int, size: int) -> None:
        out[start:stop] = np.frombuffer(data[start:stop], f"<u{size}").astype(f">u{size}").tobytes()

    n_integers, number = struct.unpack_from("<i", data, 12)[0], struct.unpack_from("<i", data, 76)[0]
    comments = range(2, number)
    lists = set()
    while number:
        start = (number - 1) * 1024
        following, _, count = struct.unpack_from("<3d", data, start)
        swap(start, start + 24, 8)
        for k in range(int(count)):
            at = start + 24 + k * (16 + 4 * (n_integers + n_integers % 2))
            swap(at, at + 16, 8)
            swap(at + 16, at + 16 + 4 * n_integers, 4)
        lists |= {number, number + 1}
        number = int(following)
    for number in range(2, len(data) // 1024 + 1):
        if number not in lists and number not in comments:
            swap((number - 1) * 1024, number * 1024, 8)
    swap(8, 16, 4)
    swap(76, 88, 4)
    out[88:96] = b"BIG-IEEE"
    return bytes(out)


def tracking(
    path: str, tai: Epochs, tag: str = "receive", kind: str = "range", count_s: float = 60.0
) -> Observations:
    """Return observations of any kind with arbitrary values at epochs of TAI."""
    return observations(path, tai, tag, kind, count_s=count_s if kind == "doppler" else np.nan)
