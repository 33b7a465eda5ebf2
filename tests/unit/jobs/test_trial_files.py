"""Results of trials on disk: damaged ones are told, whatever the damage."""

import json
import zipfile

import numpy as np
import pytest

from radioloc.errors import InputError
from radioloc.jobs.trial_folder import TrialFolder, refuse_other_study


@pytest.fixture
def files(tmp_path):
    files = TrialFolder(tmp_path, {"seed": 1}, ["east_m", "north_m"], [6.0, 12.0])
    files.start()
    return files


def test_damaged_trials(files, tmp_path):
    path = tmp_path / "parts" / "linear-000003-000003.npz"
    values = np.array([[[1.5, np.nan], [1.25, 0.5]]])
    files.add("linear", [3], values)
    np.testing.assert_array_equal(files.completed("linear")[3], values[0])
    assert files.completed("full") == {}
    sound = path.read_bytes()
    cases = [b"", b"\xff\xfe\0\1", b"trial,hours\n3,6\n", *(sound[:k] for k in range(1, len(sound), 29))]
    for content in cases:
        path.write_bytes(content)
        with pytest.raises(InputError, match=r"is damaged") as caught:
            files.completed("linear")
        assert path.name in str(caught.value)
        assert "\n" not in str(caught.value)
    for k in range(0, len(sound), 5):
        path.write_bytes(sound[:k] + bytes([sound[k] ^ 0x55]) + sound[k + 1 :])
        try:
            solution = files.completed("linear")
        except InputError:
            continue
        # What only describes the file may change; numbers have a checksum.
        assert all(np.array_equal(rows, values[0], equal_nan=True) for rows in solution.values())


def npy_header(shape, descr):
    header = f"{{'descr': {descr!r}, 'fortran_order': False, 'shape': {shape}, }}\n".encode()
    return b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header


SOUND = {"trials": np.array([3]), "values": np.zeros((1, 2, 2)), "columns": np.array(["east_m", "north_m"])}


@pytest.mark.parametrize(
    "values", [npy_header("(10**15, 2, 2)", "<f8"), npy_header("(1, 2, 2)", "|O") + bytes(100)]
)
def test_a_header_that_promises_more_than_the_file_allocates_nothing(files, tmp_path, values):
    path = tmp_path / "parts" / "linear-000003-000003.npz"
    np.savez(path, trials=SOUND["trials"], columns=SOUND["columns"])
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("values.npy", values)
    with pytest.raises(InputError, match="is damaged"):
        files.completed("linear")


@pytest.mark.parametrize("content", [b"{", b"[1]", b"\xff", b""])
def test_damaged_record_of_the_study(files, tmp_path, content):
    assert refuse_other_study(tmp_path, {"seed": 1})
    assert json.loads((tmp_path / "study.json").read_text()) == {"seed": 1}
    (tmp_path / "study.json").write_bytes(content)
    with pytest.raises(InputError, match=r"study\.json:"):
        refuse_other_study(tmp_path, {"seed": 1})
