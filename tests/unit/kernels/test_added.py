"""Kernels that a user adds: found by name, verified, refused where they are no longer what they were."""

import json

import pytest

from radioloc.cli import main
from radioloc.ephemeris import Ephemeris
from radioloc.errors import KernelError
from radioloc.kernels import find_kernel, registered
from radioloc.kernels.files import add_kernel, added, open_kernel


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("RADIOLOC_KERNELS", str(tmp_path / "added"))
    return tmp_path


@pytest.fixture
def de430(folder):
    """DE421 that calls itself DE430, with a record more, as one of its length would be taken for a damaged DE421."""
    content = find_kernel("DE421", "SPK").read_bytes()
    path = folder / "mine.bsp"
    path.write_bytes(content.replace(b"DE-0421LE-0421", b"DE-0430LE-0430") + bytes(1024))
    return path


def test_an_added_kernel_is_found_by_its_ephemeris_and_its_name(folder, de430):
    assert added() == ()
    entry = add_kernel(de430)
    assert (entry.kind, entry.ephemeris, entry.start_tdb) == ("SPK", "DE430", "1969-01-01")
    assert added() == (entry,)
    assert entry.problem() == ""
    assert find_kernel("DE430", "SPK") == find_kernel("mine.bsp") == folder / "added" / "mine.bsp"
    de430.unlink()
    assert Ephemeris.open("DE430").constants.name == "DE430"
    assert not open_kernel("DE430", "SPK").file.registered


def test_kernels_that_ship_come_first(folder):
    copy = folder / "another_de421.bpc"
    copy.write_bytes(find_kernel("DE421", "PCK").read_bytes())
    assert add_kernel(copy).ephemeris == "DE421"
    assert find_kernel("DE421", "PCK").name == "moon_pa_de421_1969_2050.bpc"
    assert find_kernel("another_de421.bpc").parent == folder / "added"


def test_one_that_changed_is_refused_and_told(folder, de430, capsys):
    entry = add_kernel(de430)
    content = bytearray(entry.path.read_bytes())
    content[-2000] ^= 1
    entry.path.write_bytes(content)
    with pytest.raises(KernelError, match="file that was added"):
        open_kernel("mine.bsp", "SPK")
    assert main(["kernels", "verify", "--json"]) == 3
    problems = {row["name"]: row["problem"] for row in json.loads(capsys.readouterr().out)}
    assert "not the file that was added" in problems.pop("mine.bsp")
    assert set(problems) == {kernel.name for kernel in registered()}
    assert set(problems.values()) == {None}
    assert main(["doctor"]) == 3
    assert "mine.bsp is not the file" in " ".join(capsys.readouterr().out.split())
    entry.path.unlink()
    assert "is missing" in entry.problem()


def test_kernels_are_listed_and_added_from_the_command_line(folder, de430, capsys):
    assert main(["kernels", "add", str(de430)]) == 0
    assert "mine.bsp" in capsys.readouterr().out
    assert main(["kernels"]) == 0
    rows = [line.split()[:3] for line in capsys.readouterr().out.splitlines()]
    assert rows == [[kernel.name, kernel.kind, kernel.ephemeris] for kernel in (*registered(), *added())]


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [("none.bsp", None, "expected a kernel file"), ("text.bsp", b"hello", "not a SPICE binary kernel")],
)
def test_what_is_no_kernel_is_not_added(folder, name, content, words):
    if content is not None:
        (folder / name).write_bytes(content)
    with pytest.raises(KernelError, match=words):
        add_kernel(folder / name)
    assert added() == ()


def test_without_a_home_directory_shipped_kernels_are_found_and_adding_names_the_variable(
    monkeypatch, de430, tmp_path
):
    monkeypatch.delenv("RADIOLOC_KERNELS", raising=False)
    monkeypatch.delenv("HOME", raising=False)
    monkeypatch.setattr("pwd.getpwuid", {}.__getitem__)  # a user id that the system does not list
    assert added() == ()
    assert find_kernel("DE440", "SPK").is_file()
    with pytest.raises(KernelError, match="RADIOLOC_KERNELS"):
        add_kernel(de430)
