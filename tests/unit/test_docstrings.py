"""Examples in docstrings run and show what they say; each public function has one."""

import doctest
import importlib
import pkgutil
import types

import pytest
from paths import EXAMPLES

import radioloc

NAMES = [m.name for m in pkgutil.walk_packages(radioloc.__path__, "radioloc.") if "__main__" not in m.name]
LONG = {"arcs", "compare", "covariance", "locate_images", "monte_carlo", "simulate", "verify"}
LONG |= {"plot", "plot_images", "plot_terms", "write_html", "write_report"}


@pytest.fixture(scope="module", autouse=True)
def _remembered():
    """Fit a study that several examples locate only once; solutions are immutable."""
    fitted, locate = {}, radioloc.locate

    def remembered(study, *arguments, **options):
        if arguments or options:
            return locate(study, *arguments, **options)
        key = str(getattr(study, "path", study)).rpartition("examples/")[2]
        return fitted[key] if key in fitted else fitted.setdefault(key, locate(study))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(radioloc, "locate", remembered)
        yield


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
        values = vars(importlib.import_module(name)).values()
        items = [value for value in values if isinstance(value, type | types.FunctionType)]
        items = [item for item in items if item.__module__ == name]
        members = [member for item in items if isinstance(item, type) for member in vars(item).values()]
        items += [getattr(member, "__func__", getattr(member, "fget", member)) for member in members]
        for item in items:
            is_named = isinstance(item, type | types.FunctionType) and item not in PUBLIC
            if is_named and ">>>" in (item.__doc__ or ""):
                yield pytest.param(item, id=f"{name}.{item.__qualname__}")


def run_examples(function, names):
    [example] = doctest.DocTestFinder(recurse=False).find(function, function.__qualname__, globs=names)
    messages: list[str] = []
    assert doctest.DocTestRunner().run(example, out=messages.append).failed == 0, "".join(messages)


@pytest.mark.parametrize("function", [*public_functions()])
def test_each_public_function_has_an_example_that_runs(function):
    assert ">>>" in function.__doc__
    run_examples(function, {})


@pytest.mark.parametrize("item", [*others_with_examples()])
def test_examples_of_classes_and_others_run(item):
    run_examples(item, dict(vars(importlib.import_module(item.__module__))))
