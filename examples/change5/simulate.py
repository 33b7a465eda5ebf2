"""Simulate 48 hours of tracking of the Chang'e-5 lander, as there was in December 2020.

    python simulate.py            write change5.csv
    python simulate.py --check    compare a new simulation with the change5.csv that is there

The real tracking data are not public. These are made so that they can stand in for them: the same place, time, stations
and kinds of data as Wang et al. (2021), Remote Sensing 13, 590, section 3, and errors of a size that leaves residuals
like those of their figure 2: VLBI delays below 2 m, ranges below 10 m. What was put in is written on top of the file.

- The lander stands where the descent images put it (their table 1): 51.9162 W, 43.0584 N, -2550.4 m.
- From landing to ascent, 2020-12-01 15:11 to 2020-12-03 15:10 UTC, one point a minute of whatever is seen.
- Ranging by Jiamusi, Kashi and Neuquen above 10 degrees. One of them sends at a time, the first of these three that
  sees the lander, and all that see it receive: two-way at the sender, three-way at the others. Who sent when is not
  published. Neuquen sees the lander only when the other two do not, so that three-way is from Jiamusi to Kashi.
- VLBI by Seshan, Miyun, Kunming and Urumqi above 15 degrees, delays on all six baselines, the first station being the
  first named. Errors of a station's arrival times are common to its baselines.
- The world departs from the model that the data are to be fitted with (the catalogue's stations, Earth
  orientation as measured, all terms but the ionosphere) by what such things are not known better than: see TRUTH.
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from radioloc.io.table import read_table, write_table
from radioloc.lunar.position import LunarPosition
from radioloc.measurements.physical_model import PhysicalModel
from radioloc.simulation import (
    Clock,
    Masks,
    Noise,
    NoiseModel,
    Schedule,
    Session,
    Truth,
    all_ranges,
    baselines,
    simulate,
)

FILE = Path(__file__).resolve().parent / "change5.csv"
SEED = 20201201
LANDER = LunarPosition.from_selenographic(-51.9162, 43.0584, -2550.4, "ME_DE421")
START, STOP, STEP_S = "2020-12-01T15:11:00", "2020-12-03T15:10:00", 60.0
RANGING = ("JIAMUSI", "KASHI", "NEUQUEN")
VLBI = ("SESHAN25", "MIYUN50", "KUNMING", "URUMQI")
X_BAND = {"wavelength_um": 35394.6}  # 8.47 GHz

SCHEDULE = Schedule(
    [
        Session(
            "range",
            all_ranges(*RANGING),
            START,
            STOP,
            STEP_S,
            sigma_m=2.5,
            one_uplink=True,
            uplink_hz=7.2e9,
            **X_BAND,
        ),
        Session("vlbi_delay", baselines(*VLBI), START, STOP, STEP_S, sigma_m=0.5, **X_BAND),
    ],
    Masks(station_deg=15.0, by_station_deg=dict.fromkeys(RANGING, 10.0)),
)

NS, MICROARCSEC = 1e-9, 4.84813681109536e-12
TRUTH = Truth(
    # DE421 as the paper has it: centimetres towards the Earth, below a metre across.
    moon_m=(0.04, -0.35, 0.25),
    libration_rad=(4e-8, -6e-8, 9e-8),
    station_enu_m={
        "JIAMUSI": (0.08, -0.05, 0.10),
        "KASHI": (-0.06, 0.09, -0.08),
        "NEUQUEN": (0.10, 0.06, 0.12),
        "SESHAN25": (0.01, -0.01, 0.02),
        "MIYUN50": (-0.04, 0.03, 0.05),
        "KUNMING": (0.02, 0.01, -0.02),
        "URUMQI": (-0.01, 0.02, 0.02),
    },
    ut1_s=2e-5,
    pole_rad=(100 * MICROARCSEC, -80 * MICROARCSEC),
    clock={
        "JIAMUSI": Clock(6 * NS),
        "KASHI": Clock(-5 * NS),
        "NEUQUEN": Clock(9 * NS),
        # What quasars leave of the VLBI stations' clocks.
        "SESHAN25": Clock(0.10 * NS, 2e-15, START),
        "MIYUN50": Clock(-0.15 * NS, -4e-15, START),
        "KUNMING": Clock(0.15 * NS, 2e-15, START),
        "URUMQI": Clock(-0.10 * NS, 3e-15, START),
    },
    range_bias_m={"JIAMUSI": 4.2, "KASHI": -3.1, "NEUQUEN": 6.5},
    # What the weather makes other than the standard atmosphere.
    zenith_delay_m={
        "JIAMUSI": 0.03,
        "KASHI": -0.02,
        "NEUQUEN": 0.05,
        "SESHAN25": 0.015,
        "MIYUN50": -0.01,
        "KUNMING": 0.01,
        "URUMQI": -0.015,
    },
    # What an ionosphere leaves that maps of it have taken out.
    tec_tecu={
        "JIAMUSI": 2.0,
        "KASHI": 3.0,
        "NEUQUEN": -4.0,
        "SESHAN25": 2.0,
        "MIYUN50": 1.0,
        "KUNMING": 3.0,
        "URUMQI": -1.0,
    },
)
NOISE = NoiseModel(
    link={
        "range": Noise(
            white_m=1.4, coloured_m=1.5, correlation_s=7200.0, outlier_fraction=0.002, outlier_m=60.0
        ),
        "vlbi_delay": Noise(white_m=0.38, outlier_fraction=0.001, outlier_m=20.0),
    },
    vlbi_station=Noise(white_m=0.15, coloured_m=0.1, correlation_s=5400.0),
)


def nominal_model():
    """The model that the data are to be fitted with."""
    return PhysicalModel.build(off=["ionosphere"])


def simulated():
    """The observations, with values to 0.1 mm, and the text on top of the file."""
    made = simulate(SCHEDULE, LANDER, TRUTH, NOISE, model=nominal_model(), seed=SEED, name="change5")
    head = (
        "SIMULATED tracking of the Chang'e-5 lander; see simulate.py.\n"
        "True position, ME_DE421: longitude -51.9162 deg, latitude 43.0584 deg, height -2550.4 m.\n"
    )
    rounded = replace(made.observations, value_m=np.round(made.observations.value_m, 4))
    return made, rounded, head + made.summary()


def main(check):
    made, observations, head = simulated()
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
    departures_m = made.noise_m + sum(made.added_m.values())
    # Ranges still have their biases, which are estimated with the position.
    for kind, largest_m in (("range", 20.0), ("vlbi_delay", 2.0)):
        rows = (observations.types() == kind) & ~made.is_outlier
        rms_m = float(np.sqrt(np.mean(departures_m[rows] ** 2)))
        print(f"{kind}: rms {rms_m:.2f} m, at most {np.abs(departures_m[rows]).max():.2f} m beside outliers")
        assert np.abs(departures_m[rows]).max() < largest_m


if __name__ == "__main__":
    main(check="--check" in sys.argv[1:])
