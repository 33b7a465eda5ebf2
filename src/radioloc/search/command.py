"""Command ``radioloc search``."""

from __future__ import annotations

import argparse
from pathlib import Path

from radioloc.cli.command import JSON, STUDY, argument, command
from radioloc.cli.output import exit_status, tell


@command(
    "search",
    STUDY,
    JSON,
    argument("--out COMPLETED.toml", "write the completed study, beside the study file", Path),
    examples=("study.toml --out completed.toml",),
)
def search(options: argparse.Namespace) -> int:
    """Find the first orbit, transmitters or manoeuvres that a study does not state."""
    from radioloc.search.study_search import require_beside, search
    from radioloc.study.study_file import read_study

    study = read_study(options.study)
    if options.out is not None:
        require_beside(options.out, study)  # fails early: the search may take long
    result = search(study)
    if options.out is not None:
        result.write(options.out)
    tell(options, result, result.to_dict)
    return exit_status(options, result)
