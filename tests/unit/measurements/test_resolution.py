"""Numbers of insufficient resolution: single precision of ranges, light times and epochs, and few decimals."""

import numpy as np
import pandas
import polars
import pyarrow
import pytest
from astropy.time import Time

from radioloc import Observations, read_observations
from radioloc.constants import C_M_S
from radioloc.errors import DataQualityWarning, InputError
from radioloc.measurements import Ramps
from radioloc.measurements.table_columns import epoch_step_s
from radioloc.time import Epochs, epochs_from_strings

RANGES_M = 789105214.865138 - 39867.727 * np.arange(12.0) + 3.1 * np.arange(12.0) ** 2
DATES = [f"2020-12-01T15:{minute:02d}:00" for minute in range(11, 23)]
METADATA = {"type": "range", "path": "KASHI>lander>KASHI", "time_tag": "receive"}


def single(values):
    return np.asarray(values, dtype=np.float32)


def columns(**changed):
    return {"epoch_utc": DATES, "observed_m": RANGES_M, "sigma_m": np.ones(12)} | changed


def from_parquet(frame, folder):
    frame.assign(**METADATA).to_parquet(folder / "ranges.parquet")
    return read_observations(folder / "ranges.parquet")


def from_csv(frame, folder):
    frame.assign(**METADATA).to_csv(folder / "ranges.csv", index=False)
    return read_observations(folder / "ranges.csv")


ENTRANCES = {
    "NumPy": lambda table, _: Observations.from_table(table, **METADATA),
    "a list": lambda table, _: Observations.from_table(
        {name: list(column) for name, column in table.items()}, **METADATA),
    "pandas": lambda table, _: Observations.from_table(pandas.DataFrame(table), **METADATA),
    "polars": lambda table, _: Observations.from_table(polars.DataFrame(table), **METADATA),
    "Arrow": lambda table, _: Observations.from_table(pyarrow.table(table), **METADATA),
    "Parquet": lambda table, folder: from_parquet(pandas.DataFrame(table), folder),
}  # fmt: skip


@pytest.mark.parametrize("enter", ENTRANCES.values(), ids=ENTRANCES.keys())
@pytest.mark.parametrize("name", ["observed_m", "light_time_s"])
def test_single_precision_with_rounding_above_sigma(enter, name, tmp_path):
    table = columns()
    table[name] = single(table.pop("observed_m") / (C_M_S if name == "light_time_s" else 1.0))
    with pytest.raises(InputError, match=r"float32 are (64|71\.5) m"):
        enter(table, tmp_path)
    coarse = enter(table | {"sigma_m": np.full(12, 100.0)}, tmp_path)
    assert np.abs(coarse.value_m - RANGES_M).max() < 36.0
    assert len(enter(columns(sigma_m=single(np.ones(12))), tmp_path)) == 12


def test_moduli_and_reference_frequencies_in_single_precision():
    """Many cycles multiply the rounding of both."""
    modulus_m = C_M_S / 1.0e6
    ambiguous = {"observed_m": np.full(12, 201.3), "modulus_m": single(np.full(12, modulus_m))}
    with pytest.raises(InputError, match="double precision"):
        Observations.from_table(columns(**ambiguous, sigma_m=np.full(12, 1e-6)), **METADATA)
    counted = {"count_s": np.full(12, 60.0), "ramped": np.ones(12), "wavelength_um": np.full(12, 35394.6)}
    doppler = columns(
        observed_m=2.0e4 + RANGES_M / 1e5, uplink_hz=single(np.full(12, 7.2e9 + 37.0)), **counted
    )
    with pytest.raises(InputError, match="double precision"):
        Observations.from_table(doppler, **METADATA | {"type": "doppler"})
    assert (
        len(Observations.from_table(doppler | {"ramped": np.zeros(12)}, **METADATA | {"type": "doppler"}))
        == 12
    )


@pytest.mark.parametrize(
    ("values", "sigma_m"),
    [
        ({"observed_m": np.round(RANGES_M, -1)}, 1.0),
        ({"observed_m": single(RANGES_M)}, 1.0),  # digits of float32 values
        ({"observed_m": [float(f"{value:.6g}") for value in RANGES_M]}, 100.0),
        ({"light_time_s": np.round(RANGES_M / C_M_S, 6)}, 10.0),
    ],
)
def test_sigmas_of_rounded_values(values, sigma_m, tmp_path):
    table = columns(**values, sigma_m=np.full(12, sigma_m))
    if "light_time_s" in values:
        del table["observed_m"]
    with pytest.warns(DataQualityWarning, match="12 readings are multiples of") as caught:
        assert from_csv(pandas.DataFrame(table), tmp_path).sigma_m.min() > 1.5 * sigma_m
    assert len(caught) == 1
    from_csv(pandas.DataFrame(table | {"sigma_m": np.full(12, 1000.0)}), tmp_path)


def test_ramps_in_single_precision():
    start, stop = (epochs_from_strings([date], "UTC") for date in DATES[:2])
    with pytest.raises(InputError, match="double precision"):
        Ramps.from_columns(["KASHI"], start, stop, single([7.2e9]), [0.0])


def test_doppler_in_single_precision_is_sufficient():
    doppler = columns(
        observed_m=single(RANGES_M / 4e4), count_s=np.full(12, 60.0), sigma_m=np.full(12, 0.006)
    )
    assert len(Observations.from_table(doppler, **METADATA | {"type": "doppler"})) == 12


def test_epochs_of_one_number_with_rounding_above_sigma():
    mjd = 59184.0 + (15.0 + np.arange(12) * 7.3 / 60.0) / 24.0
    assert epoch_step_s(Epochs.from_jd(2400000.5, mjd, "UTC").fraction) == 0.0
    with pytest.raises(InputError, match=r"steps of 3e\+02 s"):
        Observations.from_table(columns(epoch_utc=Time(single(mjd), format="mjd")), **METADATA)
    julian = Time(mjd + 2400000.5, format="jd")
    assert len(Observations.from_table(columns(epoch_utc=julian), **METADATA)) == 12
    with pytest.raises(InputError, match=r"steps of 4e-05 s"):
        Observations.from_table(columns(epoch_utc=julian, sigma_m=np.full(12, 0.005)), **METADATA)
    with pytest.raises(InputError, match="single precision"):
        Epochs.from_jd(single(mjd) + single(2400000.5), 0.0, "TDB")


def test_julian_dates_of_one_number_are_recognised():
    fraction = (2460000.5 + np.arange(0.0, 50.0) * 1.7 / 86400.0) - 2460000.5
    assert epoch_step_s(fraction) == pytest.approx(86400.0 / 2**31)
