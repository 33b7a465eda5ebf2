"""What `doctor` says of sound and of broken installations."""

import shutil
from dataclasses import replace
from datetime import date

import pytest

from radioloc.cli import main
from radioloc.earth.eop import EopTable
from radioloc.jobs import doctor as module
from radioloc.jobs.doctor import doctor
from radioloc.kernels import files


def test_a_sound_installation_is_called_sound(capsys):
    assert main(["doctor"]) == 0
    output = capsys.readouterr().out
    assert output.splitlines()[0] == "status      sound"
    assert EopTable.packaged().last_measured_date in output
    assert "before 2017-01-01" in output  # IERS Bulletin C: none since
    for kernel in files.registered():
        assert kernel.name in output


def test_old_earth_orientation_is_to_be_updated():
    measured = date.fromisoformat(EopTable.packaged().last_measured_date)
    assert "pip install --upgrade astropy-iers-data" not in str(doctor(measured))
    assert "pip install --upgrade astropy-iers-data" in str(doctor(measured.replace(year=measured.year + 1)))


@pytest.mark.parametrize(
    ("change", "words"), [("damaged", "not the file that was"), ("missing", "is missing")]
)
def test_kernels_that_are_not_those_shipped_are_told(tmp_path, monkeypatch, capsys, change, words):
    folder = shutil.copytree(files.kernel_directory(), tmp_path / "kernels")
    kernel = folder / files.registered()[0].name
    if change == "missing":
        kernel.unlink()
    else:
        content = bytearray(kernel.read_bytes())
        content[5000] ^= 1
        kernel.write_bytes(content)
    second = [replace(item, folder=folder) for item in files.registered()]
    monkeypatch.setattr(module, "registered", lambda: second)
    assert main(["doctor"]) == 3
    output = capsys.readouterr().out
    assert output.startswith("status      NOT SOUND")
    assert words in " ".join(output.split())
