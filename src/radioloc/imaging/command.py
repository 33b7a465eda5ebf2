"""Command that locates by images, for the entry points; the module is fast to import."""

from __future__ import annotations

import argparse

from radioloc.cli.command import JSON, Rows, command, output_folder, study_file
from radioloc.cli.output import finish


def _image_tables() -> Rows:
    """Return the tables of a study of images with their keys."""
    from radioloc.imaging.study import TABLES
    from radioloc.study.schema import keys_of

    tables = {f"[{name}]": ", ".join(keys_of(record)) for name, record in TABLES.items()}
    return {"tables of a study file, one of [images], [image_point] and [stereo]": tables}


@command(
    "images",
    study_file("a study file with [images], [image_point] or [stereo]"),
    JSON,
    *output_folder("write solution.json and a figure to DIR"),
    examples=("descent.toml --out results",),
    help_tables=_image_tables,
)
def images(options: argparse.Namespace) -> int:
    """Locate a lander from descent images, a point in an orbital image, or a rover from stereo images."""
    from radioloc.imaging.location import locate_images

    return finish(options, locate_images(options.study, progress=not options.quiet))
