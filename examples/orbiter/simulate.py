"""Make this example's files: a simulated low lunar orbiter, and its tracking.

    python examples/orbiter/simulate.py [DIR]

The orbit is a circle, 100 km high and nearly over the poles, as Kepler has it: nobody flew it. The tracking is computed
along it by the library itself, with noise of half a metre and a bias of 12.5 m at one station.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import spiceypy

import radioloc
from radioloc.io.table import write_table
from radioloc.measurements.registry import KINDS, TIME_TAGS

BODY = -999
GM_MOON_KM3_S2 = 4902.800076
RADIUS_KM = 1837.4
FIRST_S, LAST_S, STEP_S = 660193200.0, 660193200.0 + 6 * 3600.0, 120.0  # 2020-12-02, 15:00 to 21:00 TDB
INCLINATION, NODE = np.radians([85.0, 40.0])
SIGMA_M, RATE_SIGMA_M, BIAS_M = 0.5, 0.01, 12.5
FILES = ("orbiter.bsp", "tracking.csv")


def states_km(et_s: np.ndarray) -> np.ndarray:
    """States about the Moon in the ICRF, km and km/s."""
    rate = np.sqrt(GM_MOON_KM3_S2 / RADIUS_KM**3)
    along = np.array([np.cos(NODE), np.sin(NODE), 0.0])
    across = np.array(
        [-np.sin(NODE) * np.cos(INCLINATION), np.cos(NODE) * np.cos(INCLINATION), np.sin(INCLINATION)]
    )
    angle = rate * (et_s - FIRST_S)[:, None]
    place = RADIUS_KM * (np.cos(angle) * along + np.sin(angle) * across)
    return np.hstack([place, RADIUS_KM * rate * (np.cos(angle) * across - np.sin(angle) * along)])


def write_orbit(path: Path) -> None:
    """Write the states as an SPK of type 13 (Hermite)."""
    path.unlink(missing_ok=True)
    et_s = np.arange(FIRST_S, LAST_S + STEP_S, STEP_S)
    handle = spiceypy.spkopn(str(path), "simulated low lunar orbit", 0)
    spiceypy.spkw13(
        handle, BODY, 301, "J2000", FIRST_S, LAST_S, "circular orbit", 11, len(et_s), states_km(et_s), et_s
    )
    spiceypy.spkcls(handle)


def write_tracking(path: Path, orbit: Path) -> None:
    """Write two- and three-way ranges and Doppler every five minutes, seen or not."""
    model = radioloc.measurements.PhysicalModel.build()
    trajectory = radioloc.ephemeris.Trajectory.open(orbit, BODY)
    minutes = 15 * 60 + 5 * np.arange(1, 71)
    utc = radioloc.time.epochs_from_strings(
        [f"2020-12-02T{m // 60:02d}:{m % 60:02d}:00" for m in minutes], "UTC"
    )
    links = [radioloc.measurements.Link.from_path(f"KASHI>orbiter>{name}") for name in ("KASHI", "JIAMUSI")]
    count = len(utc)
    doppler = np.repeat([False, False, True], count)
    link = np.repeat([0, 1, 0], count)
    columns = {
        "epoch": radioloc.Epochs.concatenate([utc] * 3),
        "links": links,
        "link": link,
        "tag": TIME_TAGS.index("receive"),
        "kind": np.where(doppler, KINDS.index("doppler"), KINDS.index("range")),
        "count_s": np.where(doppler, 60.0, np.nan),
        "sigma_m": np.where(doppler, RATE_SIGMA_M, SIGMA_M),
        "uplink_hz": 7.2e9,
    }
    plan = radioloc.Observations.from_columns(value_m=1.0, **columns)
    arc = radioloc.measurements.ExactPredictor(model, plan, trajectory)
    computed = arc.compute()
    value_m = computed.value_m + plan.sigma_m * np.random.default_rng(1).standard_normal(len(plan))
    value_m += np.where(~doppler & (link == 1), BIAS_M, 0.0)
    order = np.lexsort((doppler, link, plan.epoch.fraction, plan.epoch.jd))
    observed = radioloc.Observations.from_columns(value_m=value_m, **columns).select(order)
    write_table(path, observed, comments=["Simulated: no such orbiter was tracked. See simulate.py."])


def main(folder: Path) -> None:
    """Write both files."""
    write_orbit(folder / FILES[0])
    write_tracking(folder / FILES[1], folder / FILES[0])


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
