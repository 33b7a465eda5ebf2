"""Messages, cards, tables and figures show control characters of names, and messages are of bounded length."""

import re

import pytest

from radioloc import cli
from radioloc.errors import (
    CoverageError,
    DataQualityWarning,
    FileFormatError,
    InputError,
    StationError,
    legible,
    visible,
)

ESCAPES = "\x1b[31mred\x1b[0m \x1b]0;title\x07 \x9b2J \u202ereversed\u202c \r\x08\x00"
SHOWN = r"\x1b[31mred\x1b[0m \x1b]0;title\x07 \x9b2J \u202ereversed\u202c \r\x08\x00"
CONTROL = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e]")


def shown_in(text):
    return not CONTROL.search(text) and SHOWN in text


def test_control_characters_are_shown_and_text_of_all_scripts_is_kept():
    assert visible(ESCAPES) == SHOWN
    for text in ("Łódź 嫦娥五号 نام‌ها \u200d \u00a0 ±", "two\nlines\tand a tab", ""):
        assert visible(text) == text


@pytest.mark.parametrize(
    "error",
    [
        InputError(ESCAPES),
        StationError(ESCAPES),
        FileFormatError(ESCAPES, ESCAPES, 3),
        CoverageError(ESCAPES, ("a", "b"), ("c", "d"), "advice"),
        DataQualityWarning(ESCAPES),
    ],
    ids=lambda error: type(error).__name__,
)
def test_messages_show_control_characters(error):
    assert shown_in(str(error))


@pytest.mark.parametrize("message", ["x" * 10**7, "'" + "a b " * 10**6 + "'"], ids=["a word", "a text"])
def test_messages_are_of_bounded_length(message):
    for error in (InputError(message), FileFormatError("a.csv", message, 1), DataQualityWarning(message)):
        assert len(str(error)) <= 3100
    assert legible(f"the key {message} is not known; use another").startswith("the key ")


def test_the_command_line_shows_control_characters(tmp_path, capsys):
    assert cli.main(["locate", str(tmp_path / "\x1b[31mstudy.toml")]) == 2
    output = capsys.readouterr().err
    assert r"\x1b[31mstudy.toml" in output
    assert not CONTROL.search(output)
