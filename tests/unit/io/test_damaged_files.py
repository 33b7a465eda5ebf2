"""Whatever happens to a file, reading it gives observations or one of the library's errors, nothing else."""

import gzip
import warnings

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from quick import some

from radioloc.errors import DataQualityWarning, InputError
from radioloc.io.detect import read_observations

# The damage is drawn inside the test; the file's content is the same for all examples.
# Characters that mean something in numbers, dates, paths or CSV, and some that must not pass as digits.
CHARACTERS = st.one_of(st.sampled_from('0123456789 .,-+eEnaH>:T#"\n\r\t_±٣²'), st.characters())


def read_or_refuse(path, content):
    path.write_bytes(content)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DataQualityWarning)
            observations = read_observations(path)
    except InputError as error:
        if path.name not in str(error):
            pytest.fail(f"the message does not name the file: {error}")
        return None
    assert len(observations) > 0
    assert np.isfinite(observations.value_m).all()
    assert (observations.sigma_m > 0.0).all()
    assert ((observations.epoch.fraction >= 0.0) & (observations.epoch.fraction < 1.0)).all()
    return observations


@given(data=st.data())
def test_characters_replaced_added_and_taken_away(any_text, tmp_path, data):
    text = any_text
    for _ in range(data.draw(st.integers(1, 3))):
        start = data.draw(st.integers(0, len(text)))
        length = data.draw(st.sampled_from([0, 1, 1, 1, 2, 5, 40]))
        put = data.draw(st.text(CHARACTERS, max_size=3))
        text = text[:start] + put + text[start + length :]
    read_or_refuse(tmp_path / "damaged", text.encode("utf-8", "surrogatepass"))


@given(data=st.data())
def test_lines_taken_away_repeated_and_moved(any_text, tmp_path, data):
    lines = any_text.split("\n")
    places = st.integers(0, len(lines) - 1)
    chosen = data.draw(st.lists(places, max_size=2 * len(lines)))
    kept = lines if data.draw(st.booleans()) else []
    read_or_refuse(tmp_path / "damaged", "\n".join([*kept, *(lines[i] for i in chosen)]).encode())


@given(data=st.data())
def test_fields_exchanged_for_extreme_ones(any_text, tmp_path, data):
    lines = any_text.split("\n")
    number = data.draw(st.integers(0, len(lines) - 1))
    separator = "," if "," in lines[number] else " "
    fields = lines[number].split(separator)
    extreme = ["nan", "inf", "-1", "0", "1e999", "-1e-999", "9" * 25, "na", "", "0x10", "1_0", "1e18"]
    fields[data.draw(st.integers(0, len(fields) - 1))] = data.draw(st.sampled_from(extreme))
    lines[number] = separator.join(fields)
    read_or_refuse(tmp_path / "damaged", "\n".join(lines).encode())


@given(
    content=st.binary(max_size=200), start=st.sampled_from([b"", b"\x1f\x8b", b"H1 CRD 2\n", b"512006 4 7"])
)
def test_any_bytes(tmp_path, content, start):
    read_or_refuse(tmp_path / "damaged", start + content)


@pytest.mark.parametrize("step", some([1, 7], [7]))
def test_cut_anywhere(any_text, tmp_path, step):
    content = any_text.encode()
    whole = read_or_refuse(tmp_path / "whole", content)
    for end in range(0, len(content), step):
        part = read_or_refuse(tmp_path / "cut", content[:end])
        assert part is None or len(part) <= len(whole)
        # Of these formats only CRD has an end mark.
        assert part is None or not any_text.startswith("H1") or len(part) == len(whole)
    zipped = gzip.compress(content)
    for end in range(0, len(zipped), 7 * step):
        assert read_or_refuse(tmp_path / "cut", zipped[:end]) is None
