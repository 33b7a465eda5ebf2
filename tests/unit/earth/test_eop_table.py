import numpy as np
import pytest

from radioloc.constants import ARCSEC_RAD
from radioloc.earth.eop import EopTable
from radioloc.earth.eop_prediction import extended
from radioloc.errors import CoverageError, InputError
from radioloc.time import Epochs, epochs_from_strings, utc_to_tt

MAS_RAD = 1e-3 * ARCSEC_RAD


def tt_of(*utc):
    return utc_to_tt(epochs_from_strings(list(utc), "UTC"))


def table_of(days, **changed):
    n = len(days)
    columns = {name: np.zeros(n) for name in ("xp_rad", "yp_rad", "ut1_minus_utc_s", "dx_rad", "dy_rad")}
    return EopTable(np.asarray(days, float), **(columns | {"predicted": np.zeros(n, bool)} | changed))


def days_of(table, first, last, step=1):
    """Part of a table: its days from first to last, every step-th."""
    k = np.flatnonzero((table.mjd_utc >= first) & (table.mjd_utc <= last))[::step]
    names = ("mjd_utc", "xp_rad", "yp_rad", "ut1_minus_utc_s", "dx_rad", "dy_rad", "predicted")
    return EopTable(*(getattr(table, name)[k] for name in names))


@pytest.fixture(scope="module")
def packaged():
    return EopTable.packaged()


def test_packaged_table_is_c04_then_bulletin_a(packaged):
    assert packaged.first_date == "1972-01-01"
    assert packaged.first_date < packaged.last_measured_date < packaged.last_date
    assert np.all(np.diff(packaged.mjd_utc) == 1.0)
    assert [source.split(" ")[0] for source in packaged.sources] == ["C04", "Bulletin"]
    assert all("sha256" in source for source in packaged.sources)
    assert repr(packaged).startswith("<EopTable 1972-01-01 to 20")
    # Once predicted, always predicted.
    assert np.count_nonzero(np.diff(packaged.predicted.astype(int))) == 1


@pytest.mark.parametrize(
    ("jump_s", "cause"), [(0.18, "correct the row"), (1.0, "leap seconds"), (-1.0004, "leap")]
)
def test_a_jump_of_ut1_is_ascribed_to_leap_seconds_only_if_it_is_whole(jump_s, cause):
    with pytest.raises(InputError, match=cause):
        table_of(58000.0 + np.arange(6.0), ut1_minus_utc_s=np.where(np.arange(6) == 3, -0.2 + jump_s, -0.2))


def test_rates_are_the_derivatives(packaged):
    tt = Epochs.from_jd(2459000.5 + np.arange(0.0, 200.0, 7.0), 0.4, "TT")
    values, h = packaged.interpolate(tt), 300.0
    later, earlier = packaged.interpolate(tt.shifted(h)), packaged.interpolate(tt.shifted(-h))
    for name, tolerance in (
        ("ut1_minus_tt", 1e-14),
        ("xp", 1e-18),
        ("yp", 1e-18),
        ("dx", 1e-18),
        ("dy", 1e-18),
    ):
        unit, rate_unit = ("_s", "_rate") if name == "ut1_minus_tt" else ("_rad", "_rate_rad_s")
        difference = (getattr(later, name + unit) - getattr(earlier, name + unit)) / (2 * h)
        np.testing.assert_allclose(getattr(values, name + rate_unit), difference, rtol=0, atol=tolerance)


def test_left_out_days_are_recovered_within_the_documented_error(packaged):
    # With nodes two days apart UT1 is missed by 11 us and the pole by 0.12 mas (rms); both fall fourfold when
    # the spacing is halved, so to 3 us and 0.03 mas (1.3 and 1 mm on the ground) for a day.
    first, last = 58000.0, 61300.0
    every_other = days_of(packaged, first, last, 2)
    k = np.searchsorted(packaged.mjd_utc, np.arange(first + 11, last - 11, 2))
    tt = utc_to_tt(Epochs.from_jd(packaged.mjd_utc[k] + 2400000.5, 0.0, "UTC"))
    exact = packaged.interpolate(tt)
    errors = {}
    for zonal in (True, False):
        values = every_other.interpolate(tt, zonal=zonal)
        errors[zonal] = np.std(values.ut1_minus_tt_s - exact.ut1_minus_tt_s)
        assert np.std(values.xp_rad - exact.xp_rad) < 0.15 * MAS_RAD
    assert errors[True] < 13e-6
    assert errors[False] > 1.4 * errors[True]


def test_outside_the_table_is_refused(packaged):
    with pytest.raises(CoverageError, match=r"1969-07-20 TT.*1972"):
        packaged.interpolate(Epochs.from_jd(2440422.5, 0.5, "TT"))
    with pytest.raises(CoverageError, match=r"got 2099-.*; update"):
        packaged.interpolate(Epochs.from_jd(2488000.5, 0.5, "TT"))


def test_missing_pole_offsets_are_refused_and_can_be_held():
    days = 58000.0 + np.arange(12.0)
    dx = np.where(days < 58006.0, 2e-9, np.nan)
    table = table_of(days, dx_rad=dx, dy_rad=-dx, predicted=days > 58003.0)
    # 58006 is 2017-09-10, the first day without offsets: a cubic reaches two days back from it.
    assert table.interpolate(tt_of("2017-09-07T12:00:00")).dx_rad == pytest.approx(2e-9, abs=1e-22)
    with pytest.raises(CoverageError, match=r"offsets.*2017-09-09 UTC.*2017-09-09 TT"):
        table.interpolate(tt_of("2017-09-09T12:00:00"))
    held = extended(table, "hold")
    values = held.interpolate(tt_of("2017-09-12T12:00:00"))
    assert values.dx_rad == pytest.approx(2e-9, abs=1e-22)
    assert values.dy_rad == pytest.approx(-2e-9, abs=1e-22)
    assert held.predicted[-1]


def test_prediction_is_flagged_from_the_first_value_used():
    days = 58000.0 + np.arange(12.0)
    table = table_of(days, predicted=days >= 58006.0)
    utc = [f"2017-09-{day:02d}T12:00:00" for day in (6, 7, 8, 9, 10)]  # 58002.5 to 58006.5
    np.testing.assert_array_equal(table.interpolate(tt_of(*utc)).predicted, [False, False, True, True, True])
    assert table.last_measured_date == "2017-09-09"


@pytest.mark.parametrize(
    ("days", "changed", "words"),
    [
        (58000.0 + np.arange(3.0), {}, "at least 4"),
        (58000.0 + np.arange(4.0), {"xp_rad": np.zeros(3)}, "xp_rad has shape"),
        (58000.0 + np.arange(4.0), {"ut1_minus_utc_s": np.array([0.4, 0.4, -0.6, -0.6])}, "2017-09-06"),
    ],
)
def test_tables_that_make_no_sense_are_refused(days, changed, words):
    with pytest.raises(InputError, match=words):
        table_of(days, **changed)
