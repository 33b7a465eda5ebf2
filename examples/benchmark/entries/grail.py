"""Fit the orbit of GRAIL-B to Doppler with Orekit or nyx, and write the entry of the program in a case.

    python examples/benchmark/entries/grail.py orekit|nyx examples/benchmark/grail-arcs

Orbits are the program's own; the Doppler of an orbit, and the choice of observations, are radioloc's. Noise is taken as
white, with the sigma of the residuals.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from programs import DEGREE, fitted, started, write_entry
from scipy.interpolate import CubicHermiteSpline

import radioloc
from radioloc.dynamics import Forces, GravityField, propagate
from radioloc.jobs import prepare_arc
from radioloc.jobs.benchmark import read_cases
from radioloc.measurements import ExactPredictor
from radioloc.time import Epochs, epochs_from_strings, tt_to_tdb, utc_to_tt

STEP_S = 5.0  # of states: cubic polynomials between them are within 2 um
MARGIN_S = 60.0  # light times, and counts before their tags
RADIATION_M2_KG = 0.018


class Table:
    """Trajectory through states relative to the Moon."""

    name = "GRAIL-B"

    def __init__(self, epoch, times_s, states):
        self.epoch, self.times_s = epoch, times_s
        self.position_m = CubicHermiteSpline(times_s, states[:, :3], states[:, 3:])

    def geocentric(self, ephemeris, tdb):
        times_s = tdb.seconds_since(self.epoch)
        position_m, velocity_m_s = ephemeris.geocentric("moon", tdb)
        return position_m + self.position_m(times_s), velocity_m_s + self.position_m(times_s, 1)

    def spans_s(self):
        [start_s] = self.epoch.seconds_since(Epochs.from_tdb_seconds(0.0))
        return [(start_s + self.times_s[0], start_s + self.times_s[-1])]


def result(name, file):
    """Return the program, its result for a study, and the rms residual, mm/s."""
    study = radioloc.read_study(file)
    solution, arc = radioloc.locate(study), prepare_arc(study)
    used = arc.observations.select(np.flatnonzero(solution.residuals.used))
    state = solution.state.to_dict()
    epoch = epochs_from_strings([state["epoch_tdb"]], "TDB")
    since_s = tt_to_tdb(utc_to_tt(used.epoch)).seconds_since(epoch)
    first_s, last_s = min(since_s.min() - MARGIN_S, 0.0), max(since_s.max() + MARGIN_S, STEP_S)
    forces = Forces(GravityField.open("GRGM660PRIM", DEGREE), radiation_m2_kg=RADIATION_M2_KG)
    guess = propagate(epoch, state["position_m"], state["velocity_m_s"], forces, (first_s, 1.0))
    start = epoch.shifted(first_s)
    times_s = np.arange(0.0, last_s - first_s + STEP_S, STEP_S)
    program = started(name, start)

    def predict(states):
        trajectory = Table(start, times_s, states)
        doppler_m = ExactPredictor(arc.model, used, trajectory).compute().value_m
        return np.append(doppler_m / used.sigma_m, trajectory.position_m(-first_s))

    values = np.append(np.hstack(guess.states(start)), RADIATION_M2_KG)
    residuals, estimate_m, cofactors = fitted(program, predict, used.value_m / used.sigma_m, values, times_s)
    covariance_m2 = cofactors * (residuals @ residuals) / (len(residuals) - len(values))
    rms_mm_s = 1e3 * float(np.sqrt(np.mean((residuals * used.sigma_m / used.count_s) ** 2)))
    stated = {
        "frame": "ICRF",
        "epoch_tdb": state["epoch_tdb"],
        "position_m": estimate_m.round(3).tolist(),
        "covariance_m2": covariance_m2.round(6).tolist(),
    }
    return program, stated, rms_mm_s


def main(name, folder):
    [case] = read_cases(folder)
    results, rms = {}, []
    for study in case.studies:
        program, results[study.stem], rms_mm_s = result(name, study)
        rms.append(f"{rms_mm_s:.2f}")
    text = f"{program.model}; rms of the Doppler {', '.join(rms)} mm/s; sigma: white noise of that size"
    write_entry(folder, program, text, results)


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]))
