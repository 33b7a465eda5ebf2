"""Study tables of images, for the registry that entry points fill; a file with one of them is a study of images."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from radioloc.imaging.study import ImageChoice, ImagePointChoice, StereoChoice
from radioloc.study.schema import StudyTable


def _locate(path: Path) -> Any:
    from radioloc.imaging.location import locate_images

    return locate_images(path)


IMAGES_TABLE = StudyTable("images", ImageChoice, _locate, "images")
IMAGE_POINT_TABLE = StudyTable("image_point", ImagePointChoice, _locate, "images")
STEREO_TABLE = StudyTable("stereo", StereoChoice, _locate, "images")
