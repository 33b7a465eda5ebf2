from pathlib import Path

import numpy as np
import pytest
from atmosphere_files import GPT3_CORNERS

from radioloc.errors import FileFormatError, InputError
from radioloc.media.air_files import Gpt3Grid, Gpt3Values, read_gpt3
from radioloc.media.neutral_atmosphere import zenith_hydrostatic_delay_m, zenith_wet_delay_askne_nordius_m
from radioloc.time import epochs_from_strings

GRAZ = np.deg2rad(47.0671), np.deg2rad(15.4935), 538.30
NEW_YEAR = epochs_from_strings(["2024-01-01"])


@pytest.fixture
def graz(tmp_path: Path) -> Gpt3Grid:
    path = tmp_path / "gpt3_5.grd"
    path.write_text(GPT3_CORNERS)
    return read_gpt3(path)


def test_values_printed_by_the_authors_programs(graz: Gpt3Grid) -> None:
    """gpt3_5.m, gpt3_5.f90 and gpt3_5_fast.py of TU Wien, which agree, for MJD 60310.0; to the digits printed."""
    values = graz.at(NEW_YEAR, *GRAZ)
    for name, printed, half_digit in (
        ("pressure_hpa", 959.59, 5e-3),
        ("vapour_pressure_hpa", 4.85, 5e-3),
        ("mean_temperature_k", 265.49, 5e-3),
        ("vapour_decrease_factor", 2.5189, 5e-5),
        ("hydrostatic_a", 0.00121094, 5e-9),
        ("wet_a", 0.00053970, 5e-9),
    ):
        np.testing.assert_allclose(getattr(values, name), [printed], rtol=0.0, atol=half_digit, err_msg=name)


def test_zenith_delays_from_it(graz: Gpt3Grid) -> None:
    """Printed by saasthyd.m and asknewet.m of TU Wien for the same."""
    values = graz.at(NEW_YEAR, *GRAZ)
    hydrostatic = zenith_hydrostatic_delay_m(values.pressure_hpa, GRAZ[0], GRAZ[2])
    wet = zenith_wet_delay_askne_nordius_m(
        values.vapour_pressure_hpa, values.mean_temperature_k, values.vapour_decrease_factor
    )
    np.testing.assert_allclose(hydrostatic, [2.1847], rtol=0.0, atol=5e-5)
    np.testing.assert_allclose(wet, [0.0580], rtol=0.0, atol=5e-5)


LATITUDES = np.arange(-87.5, 88.0, 5.0)
LONGITUDES = np.arange(2.5, 360.0, 5.0)


def synthetic_text(change: dict[int, float] | None = None) -> str:
    """The same everywhere: 1000 hPa, 280 K, dry or as changed by column (from 0), and without seasons."""
    row = np.zeros(64)
    row[[2, 7, 17, 22, 24, 29, 34, 39]] = 1e5, 280.0, -6.5, 40.0, 1.2, 0.5, 3.0, 270.0
    for column, value in (change or {}).items():
        row[column] = value
    tail = " ".join(f"{value:g}" for value in row[2:])
    return "\n".join(f"{latitude} {longitude} {tail}" for latitude in LATITUDES for longitude in LONGITUDES)


def at(tmp_path: Path, change: dict[int, float], date: str, height_m: float) -> Gpt3Values:
    path = tmp_path / "synthetic.grd"
    path.write_text(synthetic_text(change))
    return read_gpt3(path).at(epochs_from_strings([date]), 0.3, -2.0, height_m)


def test_dry_air_at_rest(tmp_path: Path) -> None:
    """The barometric formula over 1000 m above a point 23 m above the geoid, which is 40 m above the ellipsoid."""
    values = at(tmp_path, {23: 23.0}, "2024-05-05", 1063.0)
    scale_height_m = 8.3143 * 280.0 / (9.80665 * 28.965e-3)
    np.testing.assert_allclose(values.pressure_hpa, [1000.0 * np.exp(-1000.0 / scale_height_m)], rtol=1e-12)
    np.testing.assert_allclose(values.vapour_pressure_hpa, [0.0])
    np.testing.assert_allclose(values.hydrostatic_a, [1.2e-3])


def test_vapour_falls_with_a_power_of_pressure(tmp_path: Path) -> None:
    low, high = (at(tmp_path, {12: 8.0}, "2024-05-05", height) for height in (40.0, 2040.0))
    np.testing.assert_allclose(low.vapour_pressure_hpa, [1000.0 * 0.008 / (0.622 + 0.378 * 0.008)])
    np.testing.assert_allclose(
        high.vapour_pressure_hpa / low.vapour_pressure_hpa,
        (high.pressure_hpa / low.pressure_hpa) ** 4.0,
        rtol=1e-12,
    )


@pytest.mark.parametrize(
    ("column", "date", "expected_k"),
    [
        (40, "2024-01-01", np.cos(2 * np.pi / 365.25)),
        (41, "2023-04-01T06:00:00", np.sin(2 * np.pi * 91.25 / 365.25)),
        (42, "2023-04-01T06:00:00", np.cos(4 * np.pi * 91.25 / 365.25)),
        (43, "2023-02-14", np.sin(4 * np.pi * 45.0 / 365.25)),
    ],
)
def test_seasons(tmp_path: Path, column: int, date: str, expected_k: float) -> None:
    values = at(tmp_path, {column: 1.0}, date, 40.0)
    np.testing.assert_allclose(values.mean_temperature_k, [270.0 + expected_k], rtol=1e-12)


@pytest.mark.parametrize(
    ("old", "new", "line", "what"),
    [
        ("89942", "8994x", 2, "'8994x' is not a number"),
        ("89942", "899.42", 2, "not in Pa, K, thousandths and m"),
        ("1.24073", "1240.73", 5, "not in Pa, K, thousandths and m"),
        (" 47.30 ", " 4.7e9 ", 2, "height are not in Pa"),
        (" 47.30 ", " ", 2, "63 columns, but a grid of GPT3 has 64"),
        ("  42.5   12.5", "  42.5   13.5", None, "do not fill a grid"),
    ],
)
def test_damaged_file(tmp_path: Path, old: str, new: str, line: int | None, what: str) -> None:
    path = tmp_path / "bad.grd"
    path.write_text(GPT3_CORNERS.replace(old, new))
    with pytest.raises(FileFormatError, match=what) as caught:
        read_gpt3(path)
    assert caught.value.line == line


def test_outside(tmp_path: Path, graz: Gpt3Grid) -> None:
    with pytest.raises(InputError, match=r"reaches from latitude 42\.5 to 47\.5"):
        graz.at(NEW_YEAR, 0.0, 0.3, 0.0)
    path = tmp_path / "synthetic.grd"
    path.write_text(synthetic_text())
    with pytest.raises(InputError, match=r"reaches from latitude -87\.5 to 87\.5"):
        read_gpt3(path).at(NEW_YEAR, -np.pi / 2, 0.0, 2835.0)


def test_many_epochs(tmp_path: Path) -> None:
    path = tmp_path / "synthetic.grd"
    path.write_text(synthetic_text({40: 1.0}))
    dates = ["2024-01-01", "2024-07-01"]
    values = read_gpt3(path).at(epochs_from_strings(dates), -0.6, 2.0, 900.0)
    one_by_one = [at(tmp_path, {40: 1.0}, date, 900.0).mean_temperature_k[0] for date in dates]
    np.testing.assert_allclose(values.mean_temperature_k, one_by_one, rtol=1e-14)
    assert values.pressure_hpa.shape == (2,)
