"""What an arc-length study leaves in a folder: its table, all its numbers, a figure of its longest arc's residuals."""

from __future__ import annotations

from pathlib import Path

from radioloc.io.solution_files import write_json
from radioloc.studies.arcs import ArcStudy
from radioloc.studies.arcs_table import csv_text, markdown_text
from radioloc.studies.report import made_folder, write_figure, write_numbers
from radioloc.text_files import write_text


def write_arcs(study: ArcStudy, folder: str | Path) -> list[Path]:
    """Write ``arcs.json``, ``table1.csv``, ``table1.md``, ``figure2.png``, ``figure2.svg`` and a folder for each arc.

    Table and figure are what table 1 and figure 2 of Wang et al. (2021) show. Each arc's folder, such as ``12h``, has
    its ``solution.json`` and ``residuals.csv``.

    Parameters
    ----------
    study : ArcStudy
    folder : path-like
        Made where it does not exist; files of the same names are replaced.

    Returns
    -------
    list of Path
        What was written.

    Raises
    ------
    InputError
        A folder cannot be made or written to, or there are more links than panels fit on a page.
    """
    from radioloc.report import plot_links

    folder = made_folder(folder)
    table, markdown, numbers = (folder / name for name in ("table1.csv", "table1.md", "arcs.json"))
    write_text(table, csv_text(study))
    write_text(markdown, markdown_text(study))
    write_json(numbers, study.to_dict())
    written = [table, markdown, numbers]
    for arc in study.arcs:
        written += write_numbers(arc.solution, folder / f"{arc.hours:g}h")
    return written + write_figure(plot_links(study.longest), folder, "figure2")
