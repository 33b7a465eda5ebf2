"""Bad input from end to end: command line and library say the same, one message with place and problem.

Every case is a folder of files and a study. Nothing of it may end in a traceback, in a wrong result or in silence.
"""

import os
from dataclasses import dataclass, field

import pytest
from tdm_messages import RANGES, TWO_WAY, kvn

import radioloc
from radioloc import cli

HEADER = "epoch_utc,type,path,observed_m,sigma_m,time_tag,count_s\n"
ROWS = [
    "2021-03-28T14:00:00,range,KASHI>lander>KASHI,768800123.4,1.0,receive,\n",
    "2021-03-28T14:01:00,range,KASHI>lander>JIAMUSI,768801500.0,1.0,receive,\n",
    "2021-03-28T14:02:00,range,KASHI>lander>KASHI,768802500.0,1.0,receive,\n",
]
SIGMA = "sigma_m = { range = 1.0, vlbi_delay = 0.3, doppler = 0.01 }\n"


def message(metadata=TWO_WAY, records=RANGES, *segments):
    return "\n".join(kvn((metadata, records), *segments)) + "\n"


def table(*rows):
    return HEADER + "".join(rows or ROWS)


def study(file, observations="", estimate="", longitude_deg=-51.9):
    return (
        f"[target]\nlongitude_deg = {longitude_deg}\nlatitude_deg = 43.0\nheight_m = -2550.0\n"
        f'[observations]\nfiles = ["{file}"]\n{observations}\n[estimate]\n{estimate}\n'
    )


@dataclass
class Case:
    """Content of the data file, what the message has to contain, and what is particular to the study."""

    content: str | bytes
    parts: list[str]
    name: str = "data.kvn"
    study: dict[str, object] = field(default_factory=dict)


def csv(content, *parts, **options):
    return Case(content, ["data.csv", *parts], "data.csv", options)


def tdm(content, *parts, name="data.kvn", observations=SIGMA, **options):
    return Case(content, [name, *parts], name, {"observations": observations} | options)


TEXT = message()
CASES = {
    "csv: unknown station": csv(table(ROWS[0].replace("KASHI>l", "NOPE>l")), "line 2", "station 'NOPE'"),
    "tdm: unknown station": tdm(
        message(TWO_WAY | {"PARTICIPANT_1": "DSS-99"}), "line 12", "station 'DSS-99'"
    ),
    "csv: half of the path": csv(table(ROWS[0].replace("768800123.4", "384400061.7")), "line 2", "half"),
    "csv: kilometres": csv(table(ROWS[0].replace("768800123.4", "768800.1234")), "line 2", "in kilometres"),
    "csv: NaN": csv(table(ROWS[0].replace("768800123.4", "nan")), "line 2", "observed_m: expected"),
    "csv: a name of thousands of characters": csv(
        table(ROWS[0].replace("lander", "l" * 5000)), "line 2", "up to 80 characters", "l" * 70 + "...'"
    ),
    "csv: cut inside its last number": csv(table()[:-1] + "60", "line 4", "no line end"),
    "tdm: one-way": tdm(message(TWO_WAY | {"PATH": "2,1"}), "line 12", "768800 km one way", "correct it"),
    "value of a station without observations": Case(
        table(),
        ["[estimate] range_bias_m: expected a member with observations", "got URUMQI"],
        "data.csv",
        {"estimate": "range_bias_m = { URUMQI = 3.0 }"},
    ),
    "empty": csv("", "is empty"),
    "only a header": csv(HEADER, "expected observations"),
    "csv: semicolons": csv(table().replace(",", ";"), "line 1", "separated by commas"),
    "tdm: cut": tdm(TEXT[:-20], "line 13"),
}


def written(case, folder):
    content = case.content
    (folder / case.name).write_bytes(content.encode() if isinstance(content, str) else content)
    (folder / "study.toml").write_text(study(case.name, **case.study), encoding="utf-8")
    return folder / "study.toml"


def refused(path, parts, capsys):
    """The command line and the library say the same, and nothing else."""
    assert cli.main(["locate", str(path)]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("radioloc: ")
    assert err.count("\n") == 1
    for part in parts:
        assert part in err
    with pytest.raises(radioloc.RadiolocError) as caught:
        radioloc.locate(radioloc.read_study(path))
    assert " ".join(str(caught.value).split()) == err.removeprefix("radioloc: ").strip()


@pytest.mark.parametrize("name", CASES)
def test_refused(name, tmp_path, capsys):
    refused(written(CASES[name], tmp_path), CASES[name].parts, capsys)


def test_pipe_in_place_of_a_file(tmp_path, capsys):
    """Nobody writes to it; to open it would last for ever."""
    os.mkfifo(tmp_path / "data.csv")
    (tmp_path / "study.toml").write_text(study("data.csv"))
    refused(tmp_path / "study.toml", ["'data.csv' is a pipe or a device; give a file"], capsys)


@pytest.mark.parametrize("command", ["locate", "arcs"])
@pytest.mark.parametrize(
    ("place", "count", "reason"),
    [
        ({"longitude_deg": 128.1}, 3, "below the target's horizon"),
        ({}, 3, "3 as KASHI>lander>KASHI of {file}, line 2, below the horizon (-34.5 deg)"),
    ],
)
def test_never_seen(place, count, reason, command, tmp_path, capsys):
    """The message counts the observations of each reason."""
    rows = [row.replace("JIAMUSI", "KASHI") for row in ROWS]
    if not place:
        rows = [row.replace("T14:", "T04:") for row in rows]
    path = written(csv(table(*rows), **place), tmp_path)
    assert cli.main([command, str(path)]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    assert f"all {count} are rejected" in err
    assert reason.format(file=path.parent / "data.csv") in err
