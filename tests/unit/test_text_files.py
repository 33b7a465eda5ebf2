"""Reading and writing of text files, and errors of missing, damaged and other files."""

import gzip
import os

import pytest

from radioloc.errors import FileFormatError
from radioloc.text_files import read_lines, read_text, write_text


def test_plain_gzip_and_line_ends_give_the_same_lines(tmp_path):
    for name, content in {
        "plain": b"a\nb\xc2\xb1\n",
        "dos": b"a\r\nb\xc2\xb1\r\n",
        "mac": b"a\rb\xc2\xb1\r",
        "marked": b"\xef\xbb\xbfa\nb\xc2\xb1\n",
        "zipped.txt": gzip.compress(b"a\nb\xc2\xb1\n", mtime=0),
    }.items():
        (tmp_path / name).write_bytes(content)
        assert list(read_lines(tmp_path / name)) == ["a", "b±", ""], name


@pytest.mark.parametrize(
    ("content", "words", "line"),
    [
        (b"", "is empty", None),
        (gzip.compress(b"", mtime=0), "is empty", None),
        (gzip.compress(b"a\n" * 100, mtime=0)[:12], "cut or damaged", None),
        (b"\x1f\x9d cut", "uncompress it first", None),
        ("H1 CRD".encode("utf-16"), "is not text", None),
        (b"one line\nanother\n\0", "is not text", 3),
        (gzip.compress(b"one line\n" * 1000 + b"a\0\n", mtime=0), "is not text", 1001),
    ],
)
def test_unreadable_content_is_an_error_with_the_line(tmp_path, content, words, line):
    file = tmp_path / "a.npt"
    file.write_bytes(content)
    with pytest.raises(FileFormatError, match=words) as caught:
        list(read_lines(file))
    assert caught.value.line == line
    assert str(file) in str(caught.value)


def test_missing_file_and_directory(tmp_path):
    with pytest.raises(FileFormatError, match="no such file"):
        list(read_lines(tmp_path / "none.npt"))
    with pytest.raises(FileFormatError, match="is a directory"):
        list(read_lines(tmp_path))
    with pytest.raises(FileFormatError, match="cannot be read"):
        list(read_lines("a\0b"))


def test_latin_1_is_read(tmp_path):
    file = tmp_path / "a.grd"
    file.write_bytes(b"% Universit\xe4t\r\n1 2\r\n")
    assert list(read_lines(file, encoding="latin-1")) == ["% Universität", "1 2", ""]


@pytest.mark.skipif(os.geteuid() == 0, reason="root reads everything")
def test_file_without_permission(tmp_path):
    file = tmp_path / "a.npt"
    file.write_text("a")
    file.chmod(0)
    with pytest.raises(FileFormatError, match="cannot be read"):
        list(read_lines(file))


def test_write_replaces_the_file_without_leftovers(tmp_path):
    file = tmp_path / "a.txt"
    write_text(file, "one\n")
    write_text(file, "two ±\n")
    assert file.read_bytes() == "two ±\n".encode()
    assert [p.name for p in tmp_path.iterdir()] == ["a.txt"]
    assert file.stat().st_mode & 0o600 == 0o600


def test_failed_write_keeps_the_old_file(tmp_path):
    file = tmp_path / "a.txt"
    write_text(file, "one\n")
    with pytest.raises(FileFormatError, match="is not text"):
        write_text(file, "two \ud800\n")
    assert file.read_text() == "one\n"
    assert [p.name for p in tmp_path.iterdir()] == ["a.txt"]


def test_write_to_a_missing_folder_or_a_folder_is_refused(tmp_path):
    with pytest.raises(FileFormatError, match="make the directory"):
        write_text(tmp_path / "none" / "a.txt", "one")
    with pytest.raises(FileFormatError, match="is a directory"):
        write_text(tmp_path, "one")


def test_lines_are_read_lazily_over_block_ends(tmp_path):
    file = tmp_path / "long.txt"
    file.write_bytes(b"line\r\n" * 800_000 + b"\xff\n")
    lines = read_lines(file)
    assert [next(lines) for _ in range(600_000)] == ["line"] * 600_000
    with pytest.raises(FileFormatError, match="not UTF-8") as caught:
        list(lines)
    assert caught.value.line == 800_001


def test_pipe_without_a_writer_is_refused(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(FileFormatError, match="is a pipe"):
        read_text(tmp_path / "pipe")
