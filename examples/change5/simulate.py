"""Simulate 48 hours of tracking of the Chang'e-5 lander, as there was in December 2020.

    python simulate.py            write change5.csv
    python simulate.py --check    compare a new simulation with the change5.csv that is there

The real tracking data are not public. These are made so that they can stand in for them; `simulation.toml` says what is
tracked when and what is drawn, and what was drawn is written on top of the file. Further errors
that a fit considers are not drawn.
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

import radioloc
from radioloc.io.table import read_table, write_table

FILE = Path(__file__).resolve().parent / "change5.csv"
STUDY = FILE.with_name("simulation.toml")


def simulated():
    """The observations, with values to 0.1 mm, and the text on top of the file."""
    study = radioloc.read_study(STUDY)
    stated = study.simulation.truth_sigma.without_considered()
    made = radioloc.simulate(
        replace(study, simulation=replace(study.simulation, truth_sigma=stated)), draw_errors=True
    )
    head = "SIMULATED tracking of the Chang'e-5 lander; see simulate.py.\n"
    rounded = replace(made.observations, value_m=np.round(made.observations.value_m, 4))
    return rounded, head + made.summary()


def main(check):
    observations, head = simulated()
    if check:
        print(f"comparing with {FILE.name}")
    else:
        write_table(FILE, observations, comments=[head])
        print(f"{FILE.name}: {len(observations)} observations, {FILE.stat().st_size / 1e6:.2f} MB")
    there = read_table(FILE)
    assert (there.paths() == observations.paths()).all()
    # A machine whose sine rounds otherwise may move a last digit.
    assert np.abs(there.value_m - observations.value_m).max() < 1e-3
    assert 10_500 < len(there) < 11_500


if __name__ == "__main__":
    main(check="--check" in sys.argv[1:])
