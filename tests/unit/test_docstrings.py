"""Examples in docstrings run and show what they say; each public function has one."""

from __future__ import annotations

import doctest
import importlib
import pkgutil
import types
from pathlib import Path

import pytest

import radioloc

ROOT = Path(__file__).resolve().parents[2]
NAMES = [m.name for m in pkgutil.walk_packages(radioloc.__path__, "radioloc.") if "__main__" not in m.name]
LONG = {"arcs", "compare", "covariance", "locate_images", "monte_carlo", "simulate", "verify"}
LONG |= {f"plot_{of}" for of in ("comparison", "contours", "correlations", "covariance", "images", "trials")}
LONG.add("plot_error_by_length")
LONG |= {
    f"write_{of}" for of in ("arcs", "comparison", "covariance", "images", "monte_carlo", "report", "terms")
}


@pytest.fixture(autouse=True)
def workspace(tmp_path, monkeypatch):
    """A folder that has the project's examples, to work in."""
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize("package", ["time", "ephemeris", "earth", "lunar", "imaging"])
def test_examples(package):
    results = [
        doctest.testmod(importlib.import_module(name))
        for name in NAMES
        if name.startswith(f"radioloc.{package}.")
    ]
    assert sum(result.attempted for result in results) > 0
    assert sum(result.failed for result in results) == 0


FACES = (radioloc, radioloc.measurements, radioloc.report, radioloc.studies)


def public_functions():
    functions = {
        name: value
        for face in FACES
        for name in face.__all__
        if isinstance(value := getattr(face, name), types.FunctionType)
    }
    for name, function in functions.items():
        yield pytest.param(function, id=name, marks=[pytest.mark.slow] if name in LONG else [])


@pytest.mark.parametrize("function", [*public_functions()])
def test_each_public_function_has_an_example_that_runs(function):
    name = function.__name__
    [example] = doctest.DocTestFinder(recurse=False).find(function, name, globs={})
    assert example.examples
    told: list[str] = []
    assert doctest.DocTestRunner().run(example, out=told.append).failed == 0, "".join(told)
