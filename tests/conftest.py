"""How the tests run: how long hypothesis searches, and on how many threads linear algebra is."""

import os
from importlib.util import find_spec
from pathlib import Path

# As many processes of tests as processors leave none for threads of linear algebra. Before NumPy is imported.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import pytest
from hypothesis import HealthCheck, settings
from quick import undrawn, unsearched

from radioloc.measurements import TERMS, PhysicalModel
from radioloc.plugins import _REGISTRIES

# numba compiles a function again when its own module has changed, not when a module that it calls has.
PACKAGE = Path(find_spec("radioloc").origin).parent
CHANGED = max(source.stat().st_mtime for source in PACKAGE.rglob("_*.py"))
for index in PACKAGE.rglob("*.nbi"):
    if index.stat().st_mtime < CHANGED:
        index.unlink(missing_ok=True)

# `make test` searches a little each time, `make test-all` much longer (--hypothesis-profile=thorough). No test
# is late because other processes keep the machine busy, and fixtures of a test are made to serve all its examples.
for name, examples in {"fast": 15, "thorough": 400}.items():
    settings.register_profile(
        name,
        max_examples=examples,
        deadline=None,
        suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture],
    )
settings.load_profile("fast")


@pytest.fixture(name="undrawn")
def _undrawn():
    with undrawn():
        yield


@pytest.fixture(name="unsearched", scope="module")
def _unsearched():
    with unsearched():
        yield


@pytest.fixture
def restored_registries(monkeypatch):
    """Undo registrations after the test."""
    for registry in _REGISTRIES:
        monkeypatch.setattr(registry, "_entries", {**registry})
        monkeypatch.setattr(registry, "_registered", set())


@pytest.fixture(scope="session")
def model():
    """The physical model with all terms and without files of its own."""
    return PhysicalModel.build()


@pytest.fixture(scope="session")
def bare():
    """The physical model without any term."""
    return PhysicalModel.build(off=TERMS)
