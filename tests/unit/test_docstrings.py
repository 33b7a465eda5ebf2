"""Examples in docstrings run and show what they say; each public function has one."""

import doctest
import importlib
import pkgutil
import types

import pytest
from paths import EXAMPLES

import radioloc

NAMES = [m.name for m in pkgutil.walk_packages(radioloc.__path__, "radioloc.") if "__main__" not in m.name]
LONG = {
    "arcs",
    "compare",
    "covariance",
    "locate_images",
    "monte_carlo",
    "simulate",
    "verify",
}
LONG |= {"plot", "plot_images", "plot_terms", "write_html", "write_report"}


@pytest.fixture(autouse=True)
def workspace(tmp_path, monkeypatch):
    """A folder that has the project's examples, to work in."""
    (tmp_path / "examples").symlink_to(EXAMPLES)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("RADIOLOC_KERNELS", str(tmp_path / "kernels"))


PACKAGES = [importlib.import_module(name) for name in NAMES if name.count(".") == 1]
FACES = [radioloc, *(package for package in PACKAGES if hasattr(package, "__all__"))]
PUBLIC = {
    value: f"{face.__name__}.{name}"
    for face in reversed(FACES)
    for name in face.__all__
    if isinstance(value := getattr(face, name), types.FunctionType)
}


def public_functions():
    for function, name in PUBLIC.items():
        slow = [pytest.mark.slow] if function.__name__ in LONG else []
        yield pytest.param(function, id=name, marks=slow)


def others_with_examples():
    """Classes, their methods, and functions that are not public."""
    for name in NAMES:
        found = [one for one in vars(importlib.import_module(name)).values() if hasattr(one, "__module__")]
        own = [one for one in found if one.__module__ == name and isinstance(one, type | types.FunctionType)]
        members = [member for one in own if isinstance(one, type) for member in vars(one).values()]
        for one in own + [getattr(member, "__func__", getattr(member, "fget", member)) for member in members]:
            named = isinstance(one, type | types.FunctionType) and one not in PUBLIC
            if named and ">>>" in (one.__doc__ or ""):
                yield pytest.param(one, id=f"{name}.{one.__qualname__}")


def run_examples(found, names):
    [example] = doctest.DocTestFinder(recurse=False).find(found, found.__qualname__, globs=names)
    told: list[str] = []
    assert doctest.DocTestRunner().run(example, out=told.append).failed == 0, "".join(told)


@pytest.mark.parametrize("function", [*public_functions()])
def test_each_public_function_has_an_example_that_runs(function):
    assert ">>>" in function.__doc__
    run_examples(function, {})


@pytest.mark.parametrize("found", [*others_with_examples()])
def test_examples_of_classes_and_others_run(found):
    run_examples(found, dict(vars(importlib.import_module(found.__module__))))
