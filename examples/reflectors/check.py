"""Do the claimed sigmas hold? Halves of 2006-07, 2006-07 and 2024, and JPL's coordinates, with two ephemerides.

    python examples/reflectors/check.py

Every difference has to be below three of its sigmas, in all three dimensions together.
"""

import csv
import math
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

import radioloc
from radioloc.time import epochs_from_strings

HERE = Path(__file__).resolve().parent
MIDDLE, BETWEEN = (epochs_from_strings([day], "UTC") for day in ("2006-11-15", "2015-01-01"))
# Chance leaves a difference in three dimensions below 3.76 sigmas in 99.7 %, as below 3 in one.
LIMIT = 3.76


def jpl(ephemeris):
    """JPL's principal-axes positions, m, by target; of DE440 those of DE430."""
    lines = (line for line in (HERE / "jpl.csv").read_text().splitlines() if not line.startswith("#"))
    positions_m = {}
    for row in csv.DictReader(lines):
        radius_m = 1000.0 * float(row["de421_radius_km"])
        latitude, longitude = (math.radians(float(row[f"de421_{name}_deg"])) for name in ("lat", "lon"))
        across_m = radius_m * math.cos(latitude)
        older = [
            across_m * math.cos(longitude),
            across_m * math.sin(longitude),
            radius_m * math.sin(latitude),
        ]
        newer = [float(row[f"de430_{axis}_m"]) for axis in "xyz"]
        positions_m[row["target"]] = np.array(older if ephemeris == "DE421" else newer)
    return positions_m


def part(study, targets, **span):
    """The study of some targets and a part of the time."""
    chosen = {name: study.targets[name] for name in targets}
    observations = replace(study.observations, **span)
    return radioloc.locate(replace(study, target=None, targets=chosen, observations=observations))


def sigmas(difference_m, covariance_m2):
    """How many sigmas a difference is long."""
    return float(np.sqrt(difference_m @ np.linalg.solve(covariance_m2, difference_m)))


def apart(one, other, level):
    """Difference of two solutions of one reflector in m (east, north, up), and in sigmas of a level.

    Halves of a year share what is considered, so that "scaled" is theirs. After 17 years the orbit is off by
    something else, and other stations observe: "total".
    """
    difference_m = one.rot_pa_to_enu @ (other.position_pa_m - one.position_pa_m)
    covariance_m2 = sum(solution.position_covariance("enu", level) for solution in (one, other))
    return difference_m, sigmas(difference_m, covariance_m2)


def about_common_frame(solution, reference_m):
    """Rotation, rad, and shift, m, from the reference to the solution; chi-square before and after."""
    names = [target.name for target in solution.targets]
    rows = [solution.parameters.index(f"position.{name}.{axis}") for name in names for axis in "xyz"]
    offsets_m = solution.values[rows] - np.concatenate([reference_m[name] for name in names])
    weights = np.linalg.inv(solution.covariance[np.ix_(rows, rows)])
    frame = np.concatenate(
        [np.hstack([np.cross(np.eye(3), reference_m[name]).T, np.eye(3)]) for name in names]
    )
    moved = np.linalg.solve(frame.T @ weights @ frame, frame.T @ weights @ offsets_m)
    left_m = offsets_m - frame @ moved
    return moved[:3], moved[3:], float(offsets_m @ weights @ offsets_m), float(left_m @ weights @ left_m)


def check(ephemeris):
    """Print what the ranges say with one ephemeris; answer the differences in sigmas."""
    study = radioloc.read_study(HERE / f"{ephemeris.lower()}.toml")
    solution, reference_m = radioloc.locate(study), jpl(ephemeris)
    total = solution.fit.total
    print(
        f"{ephemeris}: {total.used} ranges, {500.0 * total.wrms_m:.0f} mm (wrms) one way, {solution.status}"
    )
    found = {}
    for target in solution.targets:
        own = solution.of_target(target.name)
        off_m = own.rot_pa_to_enu @ (own.position_pa_m - reference_m[target.name])
        found[target.name] = off_m, sigmas(off_m, own.position_covariance("enu"))
    if ephemeris != "DE421":
        found = {}  # DE430's axes are others than DE440's, by a metre
    apollo = ("apollo11", "apollo14", "apollo15")
    halves = [part(study, apollo, stop=MIDDLE), part(study, apollo, start=MIDDLE, stop=BETWEEN)]
    for name in apollo:
        found[f"{name}, halves of 2006-07"] = apart(*(half.of_target(name) for half in halves), "scaled")
    eras = part(study, apollo, stop=BETWEEN).of_target("apollo15"), part(study, ["apollo15"], start=BETWEEN)
    found["apollo15, 2024 and 2006-07"] = apart(*eras, "total")
    for what, (off_m, ratio) in found.items():
        print(
            f"  {what:28} east, north, up {off_m[0]:+.2f} {off_m[1]:+.2f} {off_m[2]:+.2f} m, {ratio:.1f} sigmas"
        )
    rotation_rad, shift_m, before, after = about_common_frame(solution, reference_m)
    rotation, shift = (" ".join(f"{v:+.2f}" for v in moved) for moved in (1737400.0 * rotation_rad, shift_m))
    print(f"  all less JPL's: chi-square {before:.0f} of 12; {after:.0f} of 6 about a common")
    print(f"    rotation of {rotation} m on the ground and shift of {shift} m (x, y, z)")
    return [ratio for _, ratio in found.values()]


if __name__ == "__main__":
    largest = max(max(check("DE421")), max(check("DE440")))
    print(f"largest difference: {largest:.1f} sigmas; allowed are {LIMIT}")
    sys.exit(largest > LIMIT)
