"""Calibration of the stated uncertainty: draws of known truth, cell by cell, with a figure and a table.

    PYTHONPATH=tests/support python tests/support/calibration.py [--draws N] [--cell NAME] [--workers N] [--out DIR]

A *cell* is a kind of tracking in a simulated world. Each draw gives the normalized error squared e^T C^-1 e of the fit
(NEES), with the error e and its stated total covariance C. It is chi-square with d degrees of freedom if C is right, so
that the mean over d is one, and 68 and 95 % of the draws are below the quantiles. Draws are kept in the folder and go
on after an interruption; they start anew with other sources. They do not depend on the number of workers.
"""

import argparse
import hashlib
import json
import math
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from scipy.stats import chi2

import radioloc

LEVELS = (0.68, 0.95)
CHUNK_DRAWS = 25
DEFAULT_DRAWS = 300
BOUND_SIGMAS = 3.0
"""Bounds of frequencies in standard deviations of a binomial, 0.3 % of correct cells outside."""
NEES_ALLOWANCE = 0.05
"""Bias of the mean NEES that does not matter: 2.5 % of a sigma."""

Draws = Callable[[Sequence[int]], Sequence[float]]
"""Normalized errors squared of some draws by their numbers, the same whatever others are drawn with them."""


@dataclass(frozen=True)
class Cell:
    """Kind of tracking in a simulated world."""

    name: str
    prepare: Callable[[], Draws]
    dof: int = 2
    remark: str = ""
    max_draws: int = DEFAULT_DRAWS
    """Draws that a cell of long computations takes at most."""


@dataclass(frozen=True)
class Calibration:
    """Frequencies of a cell beside their bounds."""

    cell: Cell
    squares: np.ndarray  # (draws,)

    @property
    def count(self) -> int:
        """Number of draws."""
        return len(self.squares)

    @property
    def nees(self) -> float:
        """Mean NEES over the degrees of freedom."""
        return float(self.squares.mean()) / self.cell.dof

    @property
    def held(self) -> list[float]:
        """Fractions of the draws inside of the regions of :data:`LEVELS`."""
        return [float(np.mean(self.squares <= chi2.ppf(level, self.cell.dof))) for level in LEVELS]

    @property
    def is_within(self) -> bool:
        """True if all numbers are within their bounds."""
        low, high = nees_bounds(self.count)
        fractions = zip(self.held, self.bounds, strict=True)
        return low <= self.nees <= high and all(first <= part <= last for part, (first, last) in fractions)

    @property
    def bounds(self) -> list[tuple[float, float]]:
        """Bounds of the fractions."""
        return [held_bounds(self.count, level) for level in LEVELS]


def nees_bounds(count: int) -> tuple[float, float]:
    """Return the bounds of the mean NEES over its degrees of freedom, for two or more of them."""
    width = BOUND_SIGMAS / math.sqrt(count) + NEES_ALLOWANCE
    return 1.0 - width, 1.0 + width


def held_bounds(count: int, level: float) -> tuple[float, float]:
    """Return bounds of the fraction of correct regions of a level that contain the truth."""
    width = BOUND_SIGMAS * math.sqrt(level * (1.0 - level) / count)
    return level - width, min(level + width, 1.0)


def cells() -> dict[str, Cell]:
    """Return all cells by name."""
    import drawn_descents
    import tracking_cells

    modules = (tracking_cells, drawn_descents)
    return {cell.name: cell for module in modules for cell in module.calibration_cells()}


@cache
def sources() -> str:
    """Checksum of the library and of the cells."""
    digest = hashlib.sha256()
    for folder in (Path(radioloc.__file__).parent, Path(__file__).parent):
        for path in sorted(folder.rglob("*.py")):
            digest.update(path.read_bytes())
    return digest.hexdigest()


@cache
def _prepared(name: str) -> Draws:
    return cells()[name].prepare()


def drawn_squares(task: tuple[str, tuple[int, ...]]) -> list[float]:
    """Return the normalized errors squared of some draws of a cell."""
    name, numbers = task
    return [float(value) for value in _prepared(name)(numbers)]


def calibrations(names: Sequence[str], draws: int, folder: Path, workers: int = 1) -> Iterator[Calibration]:
    """Yield the calibration of cells, with the draws of the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    available = cells()
    with ProcessPoolExecutor(workers) as pool:
        for name in names:
            path = folder / f"{name.replace(' ', '_').replace('/', '_')}.json"
            record = json.loads(path.read_text()) if path.exists() else {}
            squares = record["squares"] if record.get("sources") == sources() else []
            count = min(draws, available[name].max_draws)
            starts = range(len(squares), count, CHUNK_DRAWS)
            tasks = [(name, tuple(range(k, min(k + CHUNK_DRAWS, count)))) for k in starts]
            for values in pool.map(drawn_squares, tasks) if workers > 1 else map(drawn_squares, tasks):
                squares += values
                part = path.with_suffix(".part")
                part.write_text(json.dumps({"sources": sources(), "squares": squares}))
                part.replace(path)
            yield Calibration(available[name], np.array(squares[:count]))


def row(result: Calibration) -> str:
    """Return a row of the table."""
    held = " / ".join(f"{100.0 * part:.0f}" for part in result.held)
    remark = result.cell.remark if result.is_within else f"**outside** {result.cell.remark}".strip()
    return f"| {result.cell.name} | {result.count} | {result.nees:.2f} | {held} | {remark} |"


HEADING = ("| cell | draws | NEES/d | inside of 68 / 95 %, % | remark |", "| --- | ---: | ---: | --- | --- |")


def draw_figure(results: Sequence[Calibration], file: Path) -> None:
    """Draw the mean NEES and the fractions of all cells with their bounds."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 1.2 + 0.17 * len(results)), layout="constrained")
    nees_panel, held_panel = figure.subplots(1, 2, sharey=True)
    places = np.arange(len(results))
    nees_panel.axvline(1.0, color="0.5", lw=0.8)
    low, high = np.array([nees_bounds(item.count) for item in results]).T
    nees_panel.barh(places, high - low, left=low, height=0.9, color="#3b6fb6", alpha=0.15)
    nees_panel.plot([item.nees for item in results], places, "o", ms=4, color="#3b6fb6")
    nees_panel.set(xlabel="mean NEES over its degrees of freedom", ylim=(len(results) - 0.5, -0.5))
    nees_panel.set_yticks(places, [item.cell.name for item in results], fontsize=7)
    for k, colour in enumerate(("#3b6fb6", "#c2573a")):
        held_panel.axvline(100.0 * LEVELS[k], color=colour, lw=0.8)
        low, high = 100.0 * np.array([item.bounds[k] for item in results]).T
        held_panel.barh(places, high - low, left=low, height=0.9, color=colour, alpha=0.15)
        held = [100.0 * item.held[k] for item in results]
        held_panel.plot(held, places, "o", ms=4, color=colour, label=f"stated {100.0 * LEVELS[k]:.0f} %")
    held_panel.set(xlabel="truth inside of the region, %", xlim=(40.0, 101.0))
    held_panel.legend(fontsize=8)
    figure.savefig(file, dpi=100)


def main() -> None:
    """Draw cells, print their table, and write table and figure to the folder."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--draws", type=int, default=DEFAULT_DRAWS)
    parser.add_argument("--cell", action="append", help="part of the names of cells to draw; all by default")
    parser.add_argument("--workers", type=int, default=os.cpu_count())
    parser.add_argument("--out", type=Path, default=Path("out/calibration"))
    options = parser.parse_args()
    names = [name for name in cells() if options.cell is None or any(part in name for part in options.cell)]
    print(*HEADING, sep="\n", flush=True)
    results = []
    for result in calibrations(names, options.draws, options.out, options.workers):
        results.append(result)
        print(row(result), flush=True)
    if results:
        (options.out / "calibration.md").write_text("\n".join((*HEADING, *map(row, results))) + "\n")
        draw_figure(results, options.out / "calibration.png")


if __name__ == "__main__":
    from calibration import main as run  # so that cells are instances of the imported module's class

    run()
