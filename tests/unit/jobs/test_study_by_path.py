"""Whole jobs take the path of a study file where they take a study."""

from pathlib import Path

import pytest
from paths import EXAMPLES

import radioloc
from radioloc.errors import InputError

JOBS = ("locate", "compute_residuals", "arcs", "covariance", "simulate", "monte_carlo")


@pytest.mark.parametrize("job", JOBS)
@pytest.mark.parametrize("path_like", [str, Path])
def test_a_file_that_is_not_there_is_named(job, path_like):
    with pytest.raises(InputError, match=r"^nowhere\.toml:"):
        getattr(radioloc, job)(path_like("nowhere.toml"))


def test_a_study_of_tracking_is_none_of_images():
    with pytest.raises(InputError, match=r"ImageStudy.*PointStudy.*Study"):
        radioloc.imaging.locate_images(radioloc.read_study(EXAMPLES / "apollo15" / "apollo15.toml"))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda path: radioloc.Study(target=(1, 2, 3)), r"target: expected LunarPosition .* got tuple"),
        (lambda path: radioloc.imaging.read_image_study(1), "path: expected str or Path, got int 1"),
        (lambda path: radioloc.compare([None]), "solutions: expected str or Path or .* got NoneType"),
    ],
)
def test_arguments_of_wrong_types_are_named(make, message):
    with pytest.raises(InputError, match=message):
        make(EXAMPLES / "apollo15" / "apollo15.toml")
