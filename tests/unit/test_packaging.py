"""Metadata of the package, and runs without the source tree."""

import re
import subprocess
import sys
import tarfile
import zipfile
from email import message_from_string
from pathlib import Path

import pytest
from paths import EXAMPLES, ROOT

from radioloc import __version__
from radioloc.kernels import registered


def run(*command, cwd, **environment):
    done = subprocess.run(command, cwd=cwd, env=environment or None, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_the_citation_is_of_this_version():
    assert f"\nversion: {__version__}\n" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")


def test_the_terms_of_all_data_that_ship_are_listed():
    text = (ROOT / "DATA_LICENSES.md").read_text(encoding="utf-8")
    data = [path for path in (ROOT / "src").glob("radioloc/*/data/*") if path.is_file()]
    assert len(data) >= 9
    names = [path.name for path in data] + [kernel.name for kernel in registered()]
    assert [name for name in names if f"{name}`" not in text] == []


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """Source distribution, and the wheel that is built from it."""
    folder = tmp_path_factory.mktemp("dist")
    for package in ("build", "hatchling", "hatch_fancy_pypi_readme"):
        pytest.importorskip(package)
    run(sys.executable, "-m", "build", "--no-isolation", "--outdir", str(folder), str(ROOT), cwd=folder)
    (source,), (wheel,) = folder.glob("*.tar.gz"), folder.glob("*.whl")
    return source, wheel


@pytest.mark.slow
def test_on_an_index_no_link_leads_into_the_source_tree(built):
    with zipfile.ZipFile(built[1]) as wheel:
        (name,) = [name for name in wheel.namelist() if name.endswith(".dist-info/METADATA")]
        metadata = message_from_string(wheel.read(name).decode())
    readme = metadata.get_payload()
    assert readme.startswith("# radioloc")
    assert len(readme) > 5000
    links = re.findall(r"\]\(([^)]*)\)", readme)
    assert [link for link in links if not link.startswith("https://")] == []
    assert "![" not in readme
    assert (metadata["Version"], metadata["License-Expression"]) == (__version__, "MIT")
    assert metadata.get_all("License-File") == ["DATA_LICENSES.md", "LICENSE"]


@pytest.mark.slow
def test_the_source_distribution_has_what_the_tests_need(built):
    with tarfile.open(built[0]) as source:
        names = {name.partition("/")[2] for name in source.getnames()}
    tracked = run("git", "ls-files", cwd=ROOT).splitlines() if (ROOT / ".git").exists() else []
    assert set(tracked) <= names


@pytest.mark.slow
def test_the_wheel_runs_without_the_source_tree(built, tmp_path):
    """Beside the packages of this environment; `make package` has one that holds nothing else."""
    installed = tmp_path / "installed"
    run(
        *(sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--target", str(installed)),
        str(built[1]),
        cwd=tmp_path,
    )
    study = EXAMPLES / "apollo15" / "apollo15.toml"
    environment = {
        "PYTHONPATH": str(installed),
        "PATH": str(Path(sys.executable).parent),
        "HOME": str(tmp_path),
    }
    location = run(
        sys.executable, "-c", "import radioloc; print(radioloc.__file__)", cwd=tmp_path, **environment
    )
    assert location.startswith(str(installed))
    assert "kernels" in run(sys.executable, "-m", "radioloc", "doctor", cwd=tmp_path, **environment)
    card = run(sys.executable, "-m", "radioloc", "locate", str(study), cwd=tmp_path, **environment)
    assert "CONVERGED" in card
    assert "3.62849498 deg E" in card
