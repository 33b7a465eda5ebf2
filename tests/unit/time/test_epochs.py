"""Epochs of two floats: normal form, shifts, differences, and what is refused."""

import numpy as np
import pytest

from radioloc.errors import InputError
from radioloc.time import Epochs

# The fraction's last place is 1.1e-16 d, 1e-11 s; a shift and a difference round once each.
RESOLUTION_S = 2e-11


@pytest.mark.parametrize(
    ("jd", "fraction"),
    [(2459185.5, 0.25), (2459185.75, 0.0), (2459185.0, 0.75), (0.0, 2459185.75), (2459186.5, -0.75)],
)
def test_any_split_comes_to_midnight_and_fraction(jd, fraction):
    epochs = Epochs.from_jd(jd, fraction, "TDB")
    assert epochs.jd.tolist() == [2459185.5]
    assert epochs.fraction.tolist() == [0.25]
    assert epochs.mjd.tolist() == [59185.25]
    assert epochs.day_strings().tolist() == ["2020-12-02"]


def test_a_fraction_just_below_zero_is_the_next_midnight():
    epochs = Epochs.from_jd(2459185.5, [-1e-20, 1.0 - 1e-17, 1.0], "TDB")
    assert epochs.jd.tolist() == [2459185.5, 2459186.5, 2459186.5]
    assert epochs.fraction.tolist() == [0.0, 0.0, 0.0]


def test_tdb_seconds_count_from_noon_of_j2000():
    epochs = Epochs.from_tdb_seconds([0.0, -43200.0, 86400.0 * 365.25, 0.5])
    assert epochs.scale == "TDB"
    assert epochs.jd.tolist() == [2451544.5, 2451544.5, 2451909.5, 2451544.5]
    assert epochs.fraction.tolist() == [0.5, 0.0, 0.75, 0.5 + 0.5 / 86400.0]
    assert epochs.centuries_since_j2000()[2] == 0.01


def test_shift_and_difference_keep_picoseconds():
    start = Epochs.from_jd(2459185.5, [0.1, 0.9999999], "TT")
    for seconds in (1.25e-9, 1.3, -2.6, 86400.0, 1e6):
        moved = start.shifted(seconds)
        assert moved.seconds_since(start) == pytest.approx([seconds] * 2, rel=0, abs=RESOLUTION_S)
        assert ((moved.fraction >= 0.0) & (moved.fraction < 1.0)).all()


def test_utc_has_no_seconds_between_epochs():
    utc = Epochs.from_jd(2459185.5, 0.0, "UTC")
    with pytest.raises(InputError, match="TAI first"):
        utc.shifted(1.0)
    with pytest.raises(InputError, match="TAI first"):
        utc.seconds_since(utc)
    with pytest.raises(InputError, match=r"UTC.*TT"):
        Epochs.from_jd(2459185.5, 0.0, "TT").require("UTC")
    with pytest.raises(InputError, match=r"TT.*TDB"):
        Epochs.from_jd(2459185.5, 0.0, "TDB").seconds_since(Epochs.from_jd(2459185.5, 0.0, "TT"))


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_dates_that_are_no_numbers_are_refused(bad):
    with pytest.raises(InputError, match="finite"):
        Epochs.from_jd(bad, 0.0, "TDB")
    with pytest.raises(InputError, match="finite"):
        Epochs.from_jd(2459185.5, bad, "TDB")
    with pytest.raises(InputError, match="finite"):
        Epochs.from_jd(2459185.5, 0.0, "TT").shifted(bad)


def test_unknown_scale_is_refused():
    with pytest.raises(InputError, match="'GPS' is not known"):
        Epochs.from_jd(2459185.5, 0.0, "GPS")


def test_selecting_and_joining():
    epochs = Epochs.from_jd(2459185.5 + np.arange(3), 0.5, "TT")
    assert len(epochs[1]) == 1
    assert epochs[epochs.jd > 2459186.0].jd.tolist() == [2459186.5, 2459187.5]
    joined = Epochs.concatenate([epochs[:1], epochs[1:]])
    assert joined.jd.tolist() == epochs.jd.tolist()
    assert repr(epochs) == "<Epochs 3 TT 2020-12-02 to 2020-12-04>"
    assert repr(epochs[:0]) == "<Epochs none TT>"
    with pytest.raises(InputError, match="no epochs"):
        Epochs.concatenate([])
    with pytest.raises(InputError, match="TT are needed"):
        Epochs.concatenate([epochs, Epochs.from_jd(2459185.5, 0.0, "TDB")])
