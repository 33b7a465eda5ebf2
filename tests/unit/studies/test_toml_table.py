"""Taking values out of a table: what is given is either right or named in a sentence."""

from pathlib import Path

import pytest

from radioloc.errors import InputError
from radioloc.studies.toml_table import TomlTable

PATH = Path("a.toml")


def table(**content):
    return TomlTable(PATH, "estimate", content)


def test_takes_what_is_there_and_none_for_what_is_not():
    given = table(n=3, t="x", one="x", many=["x", "y"], v=[1, 2.5, 3], sub={"a": 1})
    assert given.number("n") == 3.0
    assert given.text("t") == "x"
    assert given.texts("one") == ("x",)
    assert given.texts("many") == ("x", "y")
    assert given.vector("v") == (1.0, 2.5, 3.0)
    sub = given.table("sub")
    assert sub.name == "estimate.sub"
    assert sub.number("a") == 1.0
    for method in ("number", "text", "texts", "vector", "table", "take"):
        assert getattr(given, method)("absent") is None
    given.finish()
    sub.finish()


@pytest.mark.parametrize(
    ("method", "value", "message"),
    [
        ("number", "3", "must be a number, not '3'"),
        ("number", True, "must be a number, not True"),
        ("number", [1], r"must be a number, not \[1\]"),
        ("number", float("nan"), "must be a finite number, not nan"),
        ("number", float("-inf"), "must be a finite number, not -inf"),
        ("number", 10**400, "must be a finite number, not 10000000000.*000[.][.][.]$"),
        ("text", 3, "must be a string that is not empty, not 3"),
        ("text", "", "must be a string that is not empty, not ''"),
        ("text", " ", "must be a string that is not empty"),
        ("texts", 3, "must be a list of strings that are not empty, not 3"),
        ("texts", [3], "must be a list of strings"),
        ("texts", ["a", ""], "must be a list of strings"),
        ("texts", {}, "must be a list of strings"),
        ("vector", "abc", "must be a list of three numbers, not 'abc'"),
        ("vector", [1, 2], "must be a list of three numbers"),
        ("vector", [1, 2, "3"], "must be a number, not '3'"),
        ("vector", [1, 2, float("nan")], "must be a finite number"),
    ],
)
def test_wrong_types_are_named(method, value, message):
    with pytest.raises(InputError, match=rf"^a.toml: \[estimate\] key: {message}"):
        getattr(table(key=value), method)("key")


@pytest.mark.parametrize("value", [3, "x", [{}], True])
def test_table_must_be_one(value):
    with pytest.raises(InputError, match=r"^a.toml: \[estimate.key\] must be a table, not "):
        table(key=value).table("key")


def test_what_is_left_over_is_an_error_with_a_hint():
    given = table(positon="x")
    given.text("position")
    with pytest.raises(InputError, match=r"\[estimate\] 'positon' is not known; did you mean 'position'\?"):
        given.finish()
    given = table(zzz="x")
    given.text("position")
    given.number("hours")
    with pytest.raises(InputError, match="'zzz' is not known; the keys are position, hours"):
        given.finish()


def test_errors_of_what_is_built_name_the_table():
    def make(*, a, b=7):
        if a > b:
            raise InputError(f"a is {a}")
        return a, b

    assert table().build(make, a=1, b=None) == (1, 7)
    with pytest.raises(InputError, match=r"^a.toml: \[estimate\] a is 8$"):
        table().build(make, a=8)


def test_messages_stay_on_a_line_however_long_the_value():
    with pytest.raises(InputError) as caught:
        table(key="x" * 5000).number("key")
    assert len(str(caught.value)) < 200


def test_whole_numbers_and_flags():
    assert table(key=[880, 749]).whole_numbers("key", 2) == (880, 749)
    assert table(key=True).flag("key") is True
    assert table().whole_numbers("key", 2) is table().flag("key") is None
    for value in ([880], [880, 749.0], [True, 749], "880/749"):
        with pytest.raises(InputError, match=r"\[estimate\] key: must be a list of 2 whole numbers"):
            table(key=value).whole_numbers("key", 2)
    with pytest.raises(InputError, match=r"\[estimate\] key: must be true or false, not 1"):
        table(key=1).flag("key")
