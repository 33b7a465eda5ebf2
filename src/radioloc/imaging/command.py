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
    return {
        "tables of a study file, one of [images], [image_point], [stereo], [stereo_pair] and [base_map]": tables
    }


@command(
    "images",
    study_file("a study file with [images], [image_point], [stereo] or [stereo_pair]"),
    JSON,
    *output_folder(),
    examples=("descent.toml --out results",),
    help_tables=_image_tables,
)
def images(options: argparse.Namespace) -> int:
    """Locate a lander from descent images, a point in an orbital image, or a rover from stereo images."""
    from radioloc.imaging.location import locate_images

    return finish(options, locate_images(options.study, progress=not options.quiet))


@command(
    "base-map",
    study_file("a study file with [base_map]"),
    JSON,
    *output_folder(),
    examples=("strips.toml --out map",),
    help_tables=_image_tables,
)
def base_map(options: argparse.Namespace) -> int:
    """Make a base map from overlapping orbital images, adjusted together on an elevation model."""
    from radioloc.imaging.base_map import make_base_map

    if options.out is None:
        options.parser.error("base-map needs --out DIR, where to write the map")
    return finish(options, make_base_map(options.study, options.out, progress=not options.quiet))
