"""Study tables of images, for the registry that entry points fill; a file with one of them is a study of images."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

from radioloc.imaging.study import (
    BaseMapChoice,
    ImageChoice,
    ImagePointChoice,
    StereoChoice,
    StereoPairChoice,
)
from radioloc.study.schema import StudyTable


def _locate(path: Path) -> Any:
    from radioloc.imaging.location import locate_images

    return locate_images(path)


def _adjust(path: Path) -> Any:
    from radioloc.imaging.base_map import make_base_map

    with tempfile.TemporaryDirectory() as folder:
        return make_base_map(path, folder)


IMAGES_TABLE = StudyTable("images", ImageChoice, _locate, "images")
IMAGE_POINT_TABLE = StudyTable("image_point", ImagePointChoice, _locate, "images")
STEREO_TABLE = StudyTable("stereo", StereoChoice, _locate, "images")
STEREO_PAIR_TABLE = StudyTable("stereo_pair", StereoPairChoice, _locate, "images")
BASE_MAP_TABLE = StudyTable("base_map", BaseMapChoice, _adjust, "base-map")
