"""Benchmark of faults: whether fits of simulated tracking with a fault are right, or name the fault.

``make faults FAULTS_ARGS="[--world W] [--fault F] [--seeds N] [--clean N] [--out FILE] [--list]"``.
Cells that the table of results has are not repeated; a table of another version of the library is to be deleted first.
"""

import argparse
import csv
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path

from fault_worlds import REAL, WORLDS, world
from tracking_faults import FAULTS, NO_FAULT, OUTCOMES, Fault, Outcome, run

COLUMNS = ("world", "fault", "seed", "outcome", "status", "error_m", "sigmas", "place", "named", "text")
SEEDS, CLEAN_SEEDS = 3, 60
Row = dict[str, str]


def cells(worlds: list[str], pattern: str, seeds: int, clean_seeds: int) -> Iterator[tuple[str, Fault, int]]:
    """Yield worlds, faults and seeds."""
    for name in worlds:
        for fault in (NO_FAULT, *FAULTS):
            if name in fault.worlds and pattern in fault.name:
                for seed in range(clean_seeds if fault is NO_FAULT else seeds):
                    yield name, fault, seed


def row_of(outcome: Outcome) -> Row:
    """Return the row of an outcome in the table of results."""
    values = {name: getattr(outcome, name) for name in COLUMNS}
    values |= {"error_m": f"{outcome.error_m:.4g}", "sigmas": f"{outcome.sigmas:.3g}"}
    return {name: " || ".join(v) if name == "named" else str(v) for name, v in values.items()}


def read(path: Path) -> list[Row]:
    """Return the rows of a table of results."""
    if not path.exists():
        return []
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def is_named(row: Row) -> bool:
    """Return whether a fit names a culprit."""
    return bool(row["named"]) or "culprit" in row["outcome"]


def is_right(row: Row) -> bool:
    """Return whether the culprit is named first, or in the message of a refusal."""
    if row["named"]:
        return int(row["place"]) == 0
    return row["outcome"].endswith("culprit first")


def summary(rows: Iterable[Row]) -> str:
    """Return a table of outcomes by world, and the measures with their goals."""
    rows = list(rows)
    faulty = [row for row in rows if row["fault"] != NO_FAULT.name]
    clean = [row for row in rows if row["fault"] == NO_FAULT.name]
    names = [name for name in WORLDS if any(row["world"] == name for row in rows)]
    counts = {name: Counter(row["outcome"] for row in faulty if row["world"] == name) for name in names}
    lines = [f"| outcome | {' | '.join(names)} | all |", f"| --- |{' ---: |' * (len(names) + 1)}"]
    for outcome in OUTCOMES:
        values = [counts[name][outcome] for name in names]
        lines.append(f"| {outcome} | {' | '.join(map(str, values))} | {sum(values)} |")
    named = [row for row in faulty if is_named(row)]
    correct = [row for row in rows if row["status"] != "refused" and float(row["sigmas"]) <= 3.4]
    unnamed = [row for row in correct if row["outcome"] == "refused, unnamed"]
    silent = [row for row in faulty if row["outcome"] == "silent"]
    false = [row for row in clean if row["named"]]
    measures = (
        ("silent", len(silent), len(faulty), "0"),
        ("right culprit first, of the named", sum(map(is_right, named)), len(named), "95 %"),
        ("false findings without fault", len(false), len(clean), "1 %"),
        ("correct results refused unnamed", len(unnamed), len(correct), "2 %"),
    )
    lines += ["", "| measure | count | of | share | goal |", "| --- | ---: | ---: | ---: | ---: |"]
    for name, count, total, goal in measures:
        lines.append(f"| {name} | {count} | {total} | {100.0 * count / max(total, 1):.1f} % | {goal} |")
    return "\n".join(lines)


def failures(rows: Iterable[Row]) -> str:
    """Return the fits that miss the goals: silent ones, wrong culprits, and false findings."""
    lines = []
    for row in rows:
        misnamed = is_named(row) and not is_right(row)
        refused = row["outcome"] == "refused, unnamed"
        silent = row["outcome"] == "silent" and row["fault"] != NO_FAULT.name
        if silent or misnamed or refused:
            detail = row["named"] or row["text"]
            lines.append(
                f"- {row['world']}: {row['fault']}, seed {row['seed']}: {row['outcome']}, {row['status']}, "
                f"{row['error_m']} m, {row['sigmas']} sigmas; {detail[:300]}"
            )
    return "\n".join(lines)


def main() -> None:
    """Run the cells that are missing in the table of results, and print the summary."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--world", choices=WORLDS, action="append", help="worlds; all by default")
    parser.add_argument("--fault", default="", help="part of the names of faults")
    parser.add_argument("--seeds", type=int, default=SEEDS, help="realizations of each fault")
    parser.add_argument("--clean", type=int, default=CLEAN_SEEDS, help="realizations without fault")
    parser.add_argument("--out", type=Path, default=Path("out/faults.csv"), help="table of results")
    parser.add_argument("--list", action="store_true", help="print fits that miss the goals")
    options = parser.parse_args()
    worlds = options.world or [name for name in WORLDS if name != "grail" or REAL.is_dir()]
    rows = read(options.out)
    done = {(row["world"], row["fault"], row["seed"]) for row in rows}
    options.out.parent.mkdir(parents=True, exist_ok=True)
    with options.out.open("a", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS)
        if not rows:
            writer.writeheader()
        for name, fault, seed in cells(worlds, options.fault, options.seeds, options.clean):
            if (name, fault.name, str(seed)) not in done:
                row = row_of(run(world(name), fault, seed))
                writer.writerow(row)
                file.flush()
                rows.append(row)
    print(summary(rows))
    if options.list:
        print(f"\n{failures(rows)}")


if __name__ == "__main__":
    main()
