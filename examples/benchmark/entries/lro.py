"""Fit the orbit of LRO with radioloc, Orekit or nyx, predict it, and write the entry of the program.

    python examples/benchmark/entries/lro.py radioloc|orekit|nyx

The claim comes from the data alone: the same fit to the first 35 minutes, compared with the states 5 to 20 minutes
later.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from programs import fitted, started, write_entry

from radioloc.time import Epochs

CASE = Path(__file__).resolve().parents[1] / "lro-jpl"
START = Epochs.from_jd(2459580.5, 0.0, "TDB")
RADIATION_M2_KG = 0.014  # a-priori value; estimated
LEADS = (5, 10, 15, 20)  # minutes after the last state of the fit


def predicted(program, table, last):
    """Fit the first `last` minutes; return positions of the next 20 and the rms residual, m."""
    times_s = 60.0 * np.arange(last + LEADS[-1] + 1)
    observed_m = table[: last + 1, 1:4].ravel() * 1e3
    values = np.append(table[0, 1:] * 1e3, RADIATION_M2_KG)
    residuals_m, next_m, _ = fitted(program, lambda x: x[:, :3].ravel(), observed_m, values, times_s)
    return next_m.reshape(-1, 3), float(np.sqrt(3.0 * np.mean(residuals_m**2)))


def main(name):
    program = started(name, START)
    table = np.loadtxt(CASE / "LRO_2022001_Moon_ICRF_4h.csv", delimiter=",")[:56]
    shorter_m, _ = predicted(program, table, 35)
    positions_m, rms_m = predicted(program, table, 55)
    results = {}
    for lead in LEADS:
        claim_m = float(np.linalg.norm(shorter_m[lead - 1] - table[35 + lead, 1:4] * 1e3) / np.sqrt(3.0))
        minutes = 55 + lead
        results[f"minute{minutes}"] = {
            "frame": "ICRF",
            "epoch_tdb": f"2022-01-01T{minutes // 60:02d}:{minutes % 60:02d}:00",
            "position_m": positions_m[lead - 1].round(4).tolist(),
            "sigma_m": round(claim_m, 4),
        }
    text = f"{program.model}; fit of 56 positions, rms {rms_m:.3f} m"
    text += "; sigma: error of the same fit to 36 positions at the same lead"
    write_entry(CASE, program, text, results)


if __name__ == "__main__":
    main(sys.argv[1])
