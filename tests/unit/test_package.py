"""The public face: names, what importing costs, and the first lines that a user types."""

import os
import pkgutil
import re
import subprocess
import sys

import pytest
from paths import EXAMPLES, ROOT

import radioloc

EXAMPLE = EXAMPLES / "apollo15" / "apollo15.toml"
IMPORT_LIMIT_S = 0.7
HEAVY = ("astropy", "matplotlib", "numba", "pandas", "pyarrow", "rasterio", "rich", "scipy", "spiceypy")
"""What is imported by the function that needs it."""


def test_import_is_light_and_quick(tmp_path):
    code = (
        "import time; start = time.process_time(); import radioloc, radioloc.lunar, sys; "
        "print(time.process_time() - start); "
        f"print([m for m in {HEAVY!r} if m in sys.modules])"
    )
    # The first run compiles the sources, which an installed package has done already; of the others the best counts,
    # as what else the machine does slows down some.
    environment = os.environ | {"PYTHONPYCACHEPREFIX": str(tmp_path), "PYTHONDONTWRITEBYTECODE": ""}
    command = [sys.executable, "-W", "error", "-c", code]
    seconds = []
    for _ in range(3):
        run = subprocess.run(
            command, env=environment, capture_output=True, text=True, check=True, timeout=600
        )
        duration, modules = run.stdout.splitlines()
        assert modules == "[]"
        seconds.append(float(duration))
    assert min(seconds[1:]) < IMPORT_LIMIT_S


@pytest.mark.slow
def test_a_folder_of_results_alone_brings_matplotlib(tmp_path):
    code = (
        "import radioloc.cli, sys\n"
        "for out in ([], ['--out', sys.argv[1]]):\n"
        f"    print(radioloc.cli.main(['locate', {str(EXAMPLE)!r}, '--quiet', *out]))\n"
        "    print('matplotlib' in sys.modules)"
    )
    command = [sys.executable, "-c", code, str(tmp_path / "out")]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=6000)
    assert done.stdout.splitlines() == ["0", "False", "0", "True"]


def test_dir_lists_public_names_and_packages_before_and_after_use():
    code = (
        "import radioloc; listed = dir(radioloc)\n"
        "for name in listed: getattr(radioloc, name)\n"
        "print(listed == dir(radioloc) and {*radioloc.__all__} <= {*listed})"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.split() == ["True"]


def test_public_names_do_not_clash_with_modules():
    modules = {module.name for module in pkgutil.iter_modules(radioloc.__path__)}
    assert modules.isdisjoint(radioloc.__all__)


def test_documented_packages_are_those_that_dir_lists():
    page = (ROOT / "docs" / "reference" / "python.md").read_text()
    documented = re.findall(r"^   radioloc\.(\w+)$", page, re.MULTILINE)
    assert {*documented, *radioloc.__all__} == {*dir(radioloc)}
