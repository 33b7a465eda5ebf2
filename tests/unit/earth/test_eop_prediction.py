import numpy as np
import pytest

from radioloc.constants import ARCSEC_RAD
from radioloc.earth.eop import EopTable
from radioloc.earth.eop_prediction import BEYOND, extended, last_measured_mjd, orientation_errors
from radioloc.errors import CoverageError, InputError
from radioloc.time import Epochs, utc_to_tt

COLUMNS = ("mjd_utc", "xp_rad", "yp_rad", "ut1_minus_utc_s", "dx_rad", "dy_rad", "predicted")


def until(table, last_mjd):
    days = (table.mjd_utc <= last_mjd) & (table.mjd_utc > last_mjd - 2500.0)
    return EopTable(*(getattr(table, name)[days] for name in COLUMNS))


def at(table, mjd):
    return table.interpolate(utc_to_tt(Epochs.from_jd(2400000.5, np.atleast_1d(mjd), "UTC")))


@pytest.fixture(scope="module")
def measured():
    table = EopTable.packaged()
    return until(table, last_measured_mjd(table)), table


@pytest.mark.parametrize("method", BEYOND)
def test_goes_on_from_the_last_day(measured, method):
    table = extended(measured[0], method)
    last = measured[0].mjd_utc[-1]
    earlier, later = at(table, last - 1e-3), at(table, last + 1e-3)
    # The pole moves by 3 mas a day, UT1 by 2 ms a day at most.
    assert abs(later.xp_rad - earlier.xp_rad)[0] < 0.002 * 0.003 * ARCSEC_RAD
    assert abs(later.ut1_minus_tt_s - earlier.ut1_minus_tt_s)[0] < 0.002 * 2e-3
    assert table.beyond == (method, last)
    assert table.predicted[-1]
    assert not at(table, last - 3.0).predicted[0]
    assert table.last_measured_date == measured[0].last_measured_date
    with pytest.raises(CoverageError, match="eop_beyond"):
        at(table, last + 3001.0)
    assert at(table, last + 2999.0).predicted[0]


@pytest.mark.slow
@pytest.mark.parametrize("method", BEYOND)
def test_errors_are_those_of_the_same_done_before(method):
    """Predictions from every hundredth day since 2000 have the stated errors against the later series."""
    full = EopTable.packaged()
    end = last_measured_mjd(full)
    lead_d = np.array([3.0, 10.0, 30.0, 100.0, 200.0, 365.0, 730.0, 1500.0, 2900.0])
    off = []
    for last in np.arange(51600.0, end - 100.0, 100.0):
        table = extended(until(full, last), method)
        leads = lead_d[last + lead_d < end]
        predicted, truth = at(table, last + leads), at(full, last + leads)
        ut1_s, pole_rad = orientation_errors(table, last + leads)
        ratios = [
            (predicted.ut1_minus_tt_s - truth.ut1_minus_tt_s) / ut1_s,
            (predicted.xp_rad - truth.xp_rad) / pole_rad,
            (predicted.yp_rad - truth.yp_rad) / pole_rad,
        ]
        off.append(np.pad(ratios, ((0, 0), (0, len(lead_d) - len(leads))), constant_values=np.nan))
    rms = np.sqrt(np.nanmean(np.square(off), axis=0))
    # One law for a whole range of lead times holds to a fifth. That of the pole is larger beyond half a year: it has
    # turned back by then, which a law that only grows does not know.
    assert rms.max() < 1.25
    assert rms[0].min() > 0.7
    assert rms[1:, :5].min() > 0.7


def test_errors_of_measured_and_predicted_values():
    table = EopTable.packaged()
    last = last_measured_mjd(table)
    ut1_s, pole_rad = orientation_errors(table, last + np.array([-1000.0, 40.0]))
    # Bulletin A states 0.004 s and 0.013 arcsec after 40 days.
    np.testing.assert_allclose(ut1_s, [1e-5, 0.0040], rtol=0.01)
    np.testing.assert_allclose(pole_rad / ARCSEC_RAD, [6e-5, 0.0130], rtol=0.01)


def test_what_cannot_be_extended(measured):
    with pytest.raises(InputError, match="'guess'"):
        extended(measured[0], "guess")
    short = EopTable(*(getattr(measured[0], name)[-100:] for name in COLUMNS))
    with pytest.raises(InputError, match=r"100.*1461"):
        extended(short, "extrapolate")
    assert extended(short, "hold").beyond is not None
    table = EopTable(
        *(getattr(short, n) * (np.nan if n == "dx_rad" else 1) for n in COLUMNS[:-1]), short.predicted
    )
    with pytest.raises(InputError, match="no celestial pole offset"):
        extended(table, "hold")
