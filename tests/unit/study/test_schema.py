"""Reading a table into a record: what is given is either right or named in a sentence."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import pytest

from radioloc.errors import InputError
from radioloc.study.schema import Hints, TomlTable, check, entry, keys_of

PATH = Path("a.toml")
TEXTS, VECTOR = tuple[str, ...], tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Inner:
    a: float
    b: int = 3


@dataclass(frozen=True, slots=True)
class Record:
    n: float = entry(1.0, positive=True, advice="what is in twos belongs to [other] m")
    t: str = entry("x", choices=("x", "y"))
    many: TEXTS | None = entry(None, names=True)
    v: float | VECTOR | None = None
    by_name: float | Mapping[str, float] = entry(0.0, not_negative=True)
    inner: Inner | None = None
    inners: tuple[Inner, ...] = ()
    named: Mapping[str, Inner] | None = None
    flag: bool = False
    pair: tuple[int, int] | None = None

    def __post_init__(self):
        check(self)


ADVICE = Hints(
    {"record": keys_of(Record), "other": ("m", "p")},
    {("record", "n"): Record.__dataclass_fields__["n"].metadata["advice"]},
)


def table(name="record", /, **content):
    return TomlTable(PATH, name, content, ADVICE)


def test_a_record_is_read_by_the_types_of_its_fields():
    assert table().read(Record) == Record()
    record = table(
        n=3,
        t="y",
        many="one",
        v=[1, 2.5, 3],
        by_name={"K": 1},
        inner={"a": 1},
        inners=[{"a": 1, "b": 2}, {"a": 2}],
        named={"K.1": {"a": 0}},
        flag=True,
        pair=[880, 749],
    ).read(Record)
    assert record == Record(
        n=3.0,
        t="y",
        many=("one",),
        v=(1.0, 2.5, 3.0),
        by_name={"K": 1.0},
        inner=Inner(1.0),
        inners=(Inner(1.0, 2), Inner(2.0)),
        named={"K.1": Inner(0.0)},
        flag=True,
        pair=(880, 749),
    )
    assert table(v=2).read(Record).v == 2.0
    assert Record(many="one").many == ("one",)


@pytest.mark.parametrize(
    ("kind", "value", "message"),
    [
        (float, "3", "expected a number, got '3'"),
        (float, float("nan"), "expected a finite number, got nan"),
        (str, 3, "expected a string that is not empty, got 3"),
        (str, " ", "expected a string that is not empty"),
        (TEXTS, [3], "expected a list of strings"),
        (VECTOR, "abc", "expected a list of three numbers, got 'abc'"),
        (VECTOR, [1, 2, float("nan")], "expected a finite number"),
        (tuple[int, int], [880, 749.0], "expected a whole number, got 749.0"),
        (bool, 1, "expected true or false, got 1"),
    ],
)
def test_wrong_types_are_named(kind, value, message):
    with pytest.raises(InputError, match=rf"^a.toml: \[record\] key: {message}"):
        table(key=value).get("key", kind)


@pytest.mark.parametrize("value", [3, "x", [{}], True])
def test_table_must_be_one(value):
    with pytest.raises(InputError, match=r"\[record.key\]"):
        table(key=value).get("key", Inner)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"n": 0}, "[record] n: expected a number above zero, got 0.0"),
        ({"t": "z"}, '[record] t: expected one of "x", "y", got \'z\''),
        ({"by_name": {"K": -1}}, "[record] by_name.K: expected zero or more, got -1.0"),
        ({"inner": {}}, "[record.inner] a: is missing"),
        ({"named": {"K": 3}}, "[record.named.K]: expected a table, got 3"),
        ({"p": 3}, "[record] 'p' is not known; it belongs to [other]"),
    ],
)
def test_rules_and_unknown_keys(content, message):
    with pytest.raises(InputError) as caught:
        table(**content).read(Record)
    assert str(caught.value).startswith(f"a.toml: {message}")


def test_errors_of_built_records_name_the_table():
    def make(*, a, b=7):
        if a > b:
            raise InputError(f"a is {a}")
        return a, b

    assert table().build(make, a=1, b=None) == (1, 7)
    with pytest.raises(InputError, match=r"\[record\].*8$"):
        table().build(make, a=8)


@pytest.mark.parametrize("value", ["x" * 5000, [0.5] * 5000], ids=["text", "list"])
def test_messages_stay_on_a_line_however_long_the_value(value):
    with pytest.raises(InputError) as caught:
        table(key=value).get("key", float)
    assert len(str(caught.value)) < 200
