"""Whole jobs take the path of a study file where they take a study."""

from pathlib import Path

import numpy as np
import pytest

import radioloc
from radioloc.errors import InputError

EXAMPLES = Path(__file__).resolve().parents[3] / "examples"
JOBS = ("locate", "residuals", "arcs", "covariance", "simulate", "monte_carlo")


@pytest.mark.parametrize("job", JOBS)
@pytest.mark.parametrize("path_like", [str, Path])
def test_a_file_that_is_not_there_is_named(job, path_like):
    with pytest.raises(InputError, match=r"^nowhere\.toml: there is no such study file"):
        getattr(radioloc, job)(path_like("nowhere.toml"))


@pytest.mark.parametrize("job", JOBS)
def test_what_is_neither_study_nor_path_is_refused(job):
    with pytest.raises(
        InputError, match=r"study: expected .*Study or str or Path, got list \['apollo15.toml'\]"
    ):
        getattr(radioloc, job)(["apollo15.toml"])


@pytest.mark.slow
def test_a_path_gives_what_its_study_gives():
    path = EXAMPLES / "apollo15" / "apollo15.toml"
    by_path, by_study = radioloc.locate(str(path)), radioloc.locate(study=radioloc.read_study(path))
    assert by_path.name == "apollo15"
    assert np.array_equal(by_path.position_pa_m, by_study.position_pa_m)
    assert np.array_equal(
        radioloc.residuals(study=path).residuals.residual_m,
        radioloc.residuals(radioloc.read_study(path)).residuals.residual_m,
    )


def test_a_study_of_tracking_is_none_of_images():
    with pytest.raises(
        InputError, match="study: expected ImageStudy or PointStudy or str or Path, got Study"
    ):
        radioloc.imaging.locate_images(radioloc.read_study(EXAMPLES / "apollo15" / "apollo15.toml"))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda path: radioloc.Study(target=(1, 2, 3)),
            r"target: expected LunarPosition .* got tuple \(1, 2, 3\)",
        ),
        (
            lambda path: radioloc.Study(observations="a.csv"),
            "observations: expected ObservationChoice, got str",
        ),
        (
            lambda path: radioloc.locate(path, np.zeros((3, 2))),
            "observations: expected Observations, got ndarray",
        ),
        (lambda path: radioloc.residuals(path, str(path)), "observations: expected Observations, got str"),
        (lambda path: radioloc.arcs(path, [1.0], [1, 2]), "observations: expected Observations, got list"),
        (lambda path: radioloc.read_study(None), "path: expected str or Path, got NoneType"),
        (lambda path: radioloc.imaging.read_image_study(1), "path: expected str or Path, got int 1"),
        (lambda path: radioloc.jobs.verify(None), "path: expected str or Path, got NoneType"),
        (lambda path: radioloc.jobs.verify(path, 1), "study: expected str or Path or None, got int 1"),
        (lambda path: radioloc.jobs.compare(None), "solutions: expected Iterable, got NoneType"),
        (lambda path: radioloc.jobs.compare([None]), "solutions: expected str or Path or .* got NoneType"),
        (lambda path: radioloc.covariance(None), "study: expected Study or str or Path, got NoneType"),
    ],
)
def test_arguments_of_wrong_types_are_named(make, message):
    with pytest.raises(InputError, match=message):
        make(EXAMPLES / "apollo15" / "apollo15.toml")
