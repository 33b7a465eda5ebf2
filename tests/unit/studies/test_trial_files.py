"""Results of trials on disk: damaged ones are told, whatever the damage."""

import json

import pytest

from radioloc.errors import InputError
from radioloc.studies.trial_files import TrialFolder, refuse_other_study

SOUND = "trial,hours,east_m,north_m\n3,6,1.5,\n3,12,1.25,0.5\n"


@pytest.fixture
def files(tmp_path):
    files = TrialFolder(tmp_path, {"seed": 1}, ["east_m", "north_m"], [6.0, 12.0])
    files.start()
    return files


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "is empty"),
        (b"\xff\xfe\0\1", "is not text"),
        (SOUND.replace("hours", "hour\xe9").encode("latin-1"), "not UTF-8"),
        (SOUND.replace("hours", "h").encode(), "columns are not those of the study"),
        (SOUND.replace(",0.5", "").encode(), "is damaged .a row has 3 of 4 cells.; remove"),
        (SOUND.replace("1.25", "1.2x").encode(), "is damaged"),
        (SOUND.replace("\n3,12", "\n\n3,12").encode(), "is damaged .a row has 0 of 4 cells."),
    ],
)
def test_damaged_trials(files, tmp_path, content, words):
    path = tmp_path / "parts" / "linear-000003-000003.csv"
    path.write_text(SOUND)
    assert files.found("linear")[3].shape == (2, 2)
    path.write_bytes(content)
    with pytest.raises(InputError, match=words) as caught:
        files.found("linear")
    assert path.name in str(caught.value)


@pytest.mark.parametrize("content", [b"{", b"[1]", b"\xff", b""])
def test_damaged_record_of_the_study(files, tmp_path, content):
    assert refuse_other_study(tmp_path, {"seed": 1})
    assert json.loads((tmp_path / "study.json").read_text()) == {"seed": 1}
    (tmp_path / "study.json").write_bytes(content)
    with pytest.raises(InputError, match=r"study\.json: is damaged; start anew"):
        refuse_other_study(tmp_path, {"seed": 1})
