from pathlib import Path

import numpy as np
import pytest

from radioloc.earth.gpt3 import Gpt3Grid, Gpt3Values, read_gpt3
from radioloc.earth.radio_troposphere import zenith_hydrostatic_delay_m, zenith_wet_delay_askne_nordius_m
from radioloc.errors import FileFormatError, InputError
from radioloc.time import epochs_from_strings

GRAZ_CORNERS = """\
% lat lon p T Q dT undu Hs a_h a_w lambda Tm Gn_h Ge_h Gn_w Ge_w
  47.5   12.5  89942  -161 -172   56   16 281.0  -8.4 -3.1  0.1  0.1  5.13 -2.91 -1.20  0.34  0.34  -6.5   0.6 -0.2 \
 0.2 -0.1   47.30  1024.64  1.23150 -0.02207 -0.01128  0.00094  0.00117  0.52028 -0.00629 -0.01043  0.00399  0.00109 \
2.7298 -0.1177  0.0419 -0.0809  0.0315 270.2  -7.1 -3.1  0.2  0.1  -19.32  -2.57   0.36  -0.79  -0.44  -4.78  -3.43 \
 -1.22  -0.74  -1.67 -10.46   9.84   2.57  -1.57  -1.27  -0.75  -0.44   0.20   0.46   0.59
  47.5   17.5  99762   183  -97   41   -6 284.8 -10.5 -2.7 -0.3  0.1  6.21 -3.28 -1.34  0.41  0.22  -5.4   1.6 -0.0 \
 0.0  0.1   44.86   160.75  1.23260 -0.02330 -0.01094  0.00076  0.00085  0.55990 -0.00898 -0.00981  0.00444  0.00265 \
2.6067 -0.1332  0.0308 -0.0796 -0.0208 273.9  -7.8 -3.0  0.1 -0.1  -18.61  -3.39   0.19  -0.53  -0.20  -6.21  -1.92 \
 -2.05  -0.80  -2.00  -4.88   1.04   0.16   1.44   0.43  -1.97   2.79   0.96  -0.35  -0.80
  42.5   12.5  95267   -27 -113   37   -3 286.9  -8.0 -3.5  0.4  0.4  7.07 -2.46 -1.62  0.07  0.23  -5.6   0.7 -0.2 \
 0.4 -0.1   48.13   538.45  1.24106 -0.02108 -0.01120  0.00139  0.00170  0.53180 -0.01361 -0.00929  0.00104 -0.00214 \
3.3387  0.1132  0.0503 -0.0240  0.0831 275.9  -6.6 -3.4  0.5  0.5  -19.13  -0.67   0.41   0.05  -1.33  -3.34  -0.87 \
 -1.44  -1.20  -2.47   2.13  -5.54  -0.31   2.87   1.42   6.52  -6.08  -0.68   2.43   1.65
  42.5   17.5 100596   176  -52    9  -49 290.0  -7.6 -3.6  0.4  0.6  8.42 -3.57 -1.86  0.31  0.44  -6.1  -1.4  0.0 \
 0.2 -0.1   43.23    75.92  1.24073 -0.02182 -0.01135  0.00123  0.00143  0.55628 -0.01250 -0.00849  0.00018 -0.00217 \
3.3502 -0.2126 -0.0046 -0.0141  0.0751 278.1  -7.1 -3.4  0.5  0.4  -12.32  -1.84   0.40   0.03  -0.97  -5.56   0.93 \
 -0.88  -1.23  -2.34   6.63 -11.67  -0.46   3.29   1.77   5.45  -4.04  -0.49   1.18   0.30
"""
"""The four points of gpt3_5.grd (TU Wien) around Graz."""

GRAZ = np.deg2rad(47.0671), np.deg2rad(15.4935), 538.30
NEW_YEAR = epochs_from_strings(["2024-01-01"])


@pytest.fixture
def graz(tmp_path: Path) -> Gpt3Grid:
    path = tmp_path / "gpt3_5.grd"
    path.write_text(GRAZ_CORNERS)
    return read_gpt3(path)


def test_values_printed_by_the_authors_programs(graz: Gpt3Grid) -> None:
    """gpt3_5.m, gpt3_5.f90 and gpt3_5_fast.py of TU Wien, which agree, for MJD 60310.0; to the digits printed."""
    values = graz.at(NEW_YEAR, *GRAZ)
    for name, printed, half_digit in (
        ("pressure_hpa", 959.59, 5e-3),
        ("temperature_k", 1.24 + 273.15, 5e-3),
        ("vapour_pressure_hpa", 4.85, 5e-3),
        ("lapse_rate_k_m", -4.703e-3, 5e-7),
        ("mean_temperature_k", 265.49, 5e-3),
        ("vapour_decrease_factor", 2.5189, 5e-5),
        ("hydrostatic_a", 0.00121094, 5e-9),
        ("wet_a", 0.00053970, 5e-9),
        ("undulation_m", 45.784, 5e-4),
    ):
        np.testing.assert_allclose(getattr(values, name), [printed], rtol=0.0, atol=half_digit, err_msg=name)
    np.testing.assert_allclose(
        values.gradients_m, [[-2.206e-4, -8.750e-5, -2.211e-5, 2.275e-6]], rtol=0.0, atol=5e-9
    )


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
    np.testing.assert_allclose(values.temperature_k, [273.5], rtol=1e-12)
    np.testing.assert_allclose(values.vapour_pressure_hpa, [0.0])
    np.testing.assert_allclose(values.hydrostatic_a, [1.2e-3])
    np.testing.assert_allclose(values.undulation_m, [40.0])


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
        (8, "2024-01-01", np.cos(2 * np.pi / 365.25)),
        (9, "2023-04-01T06:00:00", np.sin(2 * np.pi * 91.25 / 365.25)),
        (10, "2023-04-01T06:00:00", np.cos(4 * np.pi * 91.25 / 365.25)),
        (11, "2023-02-14", np.sin(4 * np.pi * 45.0 / 365.25)),
    ],
)
def test_seasons(tmp_path: Path, column: int, date: str, expected_k: float) -> None:
    values = at(tmp_path, {column: 1.0}, date, 40.0)
    np.testing.assert_allclose(values.temperature_k, [280.0 + expected_k], rtol=1e-12)


@pytest.mark.parametrize(
    ("old", "new", "line", "what"),
    [
        ("89942", "8994x", 2, "'8994x' is not a number"),
        ("89942", "899.42", 2, "not in Pa, K and thousandths"),
        ("1.24073", "1240.73", 5, "not in Pa, K and thousandths"),
        (" 47.30 ", " ", 2, "63 columns, but a grid of GPT3 has 64"),
        ("  42.5   12.5", "  42.5   13.5", None, "do not fill a grid"),
    ],
)
def test_damaged_file(tmp_path: Path, old: str, new: str, line: int | None, what: str) -> None:
    path = tmp_path / "bad.grd"
    path.write_text(GRAZ_CORNERS.replace(old, new))
    with pytest.raises(FileFormatError, match=what) as caught:
        read_gpt3(path)
    assert caught.value.line == line


def test_outside(tmp_path: Path, graz: Gpt3Grid) -> None:
    with pytest.raises(InputError, match=r"reaches from latitude 42\.5 to 47\.5"):
        graz.at(NEW_YEAR, 0.0, 0.3, 0.0)
    with pytest.raises(InputError, match="latitude is 47"):
        graz.at(NEW_YEAR, 47.0, 0.3, 0.0)
    path = tmp_path / "synthetic.grd"
    path.write_text(synthetic_text())
    with pytest.raises(InputError, match=r"reaches from latitude -87\.5 to 87\.5"):
        read_gpt3(path).at(NEW_YEAR, -np.pi / 2, 0.0, 2835.0)


def test_many_epochs_and_places(tmp_path: Path) -> None:
    path = tmp_path / "synthetic.grd"
    path.write_text(synthetic_text({8: 1.0}))
    epochs = epochs_from_strings(["2024-01-01", "2024-07-01"])
    values = read_gpt3(path).at(epochs, [0.1, -0.6], [0.0, 2.0], [0.0, 900.0])
    assert values.pressure_hpa.shape == (2,)
    assert values.gradients_m.shape == (2, 4)
