"""Files of VMF3 and GPT3: values published by TU Wien, heights, and files that cannot be used."""

from pathlib import Path

import numpy as np
import pytest
from atmosphere_files import GPT3_CORNERS, VMF3_SITES, orography_text, vmf3_map_text

from radioloc.errors import CoverageError, FileFormatError, InputError
from radioloc.media.air_files import Gpt3Grid, read_gpt3, read_vmf3_grids, read_vmf3_sites
from radioloc.media.neutral_atmosphere import zenith_hydrostatic_delay_m, zenith_wet_delay_askne_nordius_m
from radioloc.time import epochs_from_strings, utc_to_tt

GRAZ = np.deg2rad(47.0671), np.deg2rad(15.4935), 538.30
NEW_YEAR = epochs_from_strings(["2024-01-01"], "UTC")


def written(path: Path, text: str) -> Path:
    path.write_text(text)
    return path


@pytest.fixture
def sites(tmp_path: Path) -> Path:
    return written(tmp_path / "2024001.vmf3_r", VMF3_SITES)


@pytest.fixture
def maps(tmp_path: Path) -> tuple[list[Path], Path]:
    paths = [written(tmp_path / f"VMF3_20240101.H{hour:02d}", vmf3_map_text(hour)) for hour in (6, 0)]
    return paths, written(tmp_path / "orography_ell_5x5", orography_text())


def test_site_at_and_between_epochs_of_any_scale(sites: Path) -> None:
    series = read_vmf3_sites([sites])
    assert set(series) == {"GRAZ", "WETTZELL"}
    utc = epochs_from_strings([f"2024-01-01T{time}" for time in ("00:00", "03:00", "07:30", "12:00")], "UTC")
    for epochs in (utc, utc_to_tt(utc)):
        values = series["GRAZ"].values_at(epochs)
        np.testing.assert_allclose(values.hydrostatic_a, [1.2048e-3, 1.19953e-3, 1.195035e-3, 1.19736e-3])
        np.testing.assert_allclose(values.wet_a, [5.8178e-4, 5.5306e-4, 5.0274e-4, 4.3794e-4])
        np.testing.assert_allclose(values.zenith_hydrostatic_m, [2.1686, 2.17045, 2.173625, 2.1776])
        np.testing.assert_allclose(values.zenith_wet_m, [0.1047, 0.08765, 0.066325, 0.0535])
        assert values.mapping_height_m == 0.0


def test_zenith_delay_of_the_file_is_that_of_its_pressure(sites: Path) -> None:
    graz = read_vmf3_sites([sites])["GRAZ"]
    computed = zenith_hydrostatic_delay_m(np.array([951.19, 953.07, 955.28]), GRAZ[0], GRAZ[2])
    # The server integrates the column with other constants of refractivity: 2.4 to 3.0 mm more here.
    np.testing.assert_allclose(graz.values[:, 2] - computed, 0.0027, atol=4e-4)


@pytest.mark.parametrize(
    ("old", "new", "line", "words"),
    [
        ("0.00119426", "0.0011x", 4, "'0.0011x' is not a number"),
        ("0.00119426", "1.19426", 4, "got 1.19426"),
        ("  953.07", "", 4, "got 8"),
        ("60310.25  0.00119426", "60310.00  0.00119426", 4, "GRAZ: MJD 60310.00"),
        (VMF3_SITES, "# nothing\n", None, "expected lines of stations"),
    ],
)
def test_damaged_site_file(tmp_path: Path, old: str, new: str, line: int | None, words: str) -> None:
    path = written(tmp_path / "bad.vmf3_r", VMF3_SITES.replace(old, new))
    with pytest.raises(FileFormatError, match=words) as caught:
        read_vmf3_sites([path])
    assert caught.value.line == line


def test_map_in_space_and_time(maps: tuple[list[Path], Path]) -> None:
    grids = read_vmf3_grids(*maps)
    epochs = epochs_from_strings(["2024-01-01T00:00:00", "2024-01-01T03:00:00", "2024-01-01T06:00:00"], "UTC")
    for latitude_deg, longitude_deg in ((35.0, 0.0), (-20.0, -116.9), (87.5, 355.0)):
        values = grids.values_at(epochs, np.deg2rad(latitude_deg), np.deg2rad(longitude_deg), 300.0)
        expected = 1.2e-3 + 1e-6 * latitude_deg + 1e-6 * np.array([0.0, 3.0, 6.0])
        np.testing.assert_allclose(values.hydrostatic_a, expected, rtol=1e-10)
        np.testing.assert_allclose(values.wet_a, 5.5e-4)
        assert values.mapping_height_m == 300.0
        # The height is that of the map.
        np.testing.assert_allclose(values.zenith_hydrostatic_m, 2.2, rtol=1e-12)
        np.testing.assert_allclose(values.zenith_wet_m, 0.1, rtol=1e-12)


def test_zenith_delays_are_reduced_to_the_height(maps: tuple[list[Path], Path]) -> None:
    values = read_vmf3_grids(*maps).values_at(NEW_YEAR, 0.6, 1.0, 1300.0)
    # Kouba (2008), with the pressure of 2.2 m of delay at 300 m.
    pressure_hpa = 2.2 / zenith_hydrostatic_delay_m(1.0e3, 0.6, 300.0) * 1.0e3
    above_hpa = pressure_hpa * (1.0 - 2.26e-5 * 1000.0) ** 5.225
    expected = zenith_hydrostatic_delay_m(above_hpa, 0.6, 1300.0)
    np.testing.assert_allclose(values.zenith_hydrostatic_m, expected, rtol=1e-12)
    np.testing.assert_allclose(values.zenith_wet_m, 0.1 * np.exp(-0.5), rtol=1e-12)


def test_map_with_gradients_along_a_parallel(tmp_path: Path, maps: tuple[list[Path], Path]) -> None:
    paths = [
        written(tmp_path / f"V3GR.H{hour:02d}", vmf3_map_text(hour, "V3GR", 0.05, " 0.1 0.2 0.3 0.4"))
        for hour in (0, 6)
    ]
    grids, epoch = read_vmf3_grids(paths, maps[1]), epochs_from_strings(["2024-01-01T01:00:00"], "UTC")
    # Across the meridian of Greenwich the chord over 5 degrees is 1e-3 below the cosine.
    for longitude_deg, crest_deg in ((0.0, 2.5), (92.5, 92.5), (182.5, 182.5)):
        values = grids.values_at(epoch, 0.5, np.deg2rad(longitude_deg), 300.0)
        expected_m = 0.1 + 0.05 * np.cos(np.deg2rad(crest_deg))
        np.testing.assert_allclose(values.zenith_wet_m, expected_m, rtol=0.0, atol=1e-6)


MAP = vmf3_map_text(0)


@pytest.mark.parametrize(
    ("text", "line", "words"),
    [
        (MAP.replace("VMF3 (", "VMF1 ("), 2, "expected VMF3 or V3GR"),
        (MAP.replace("01 01 00 00", "13 01 00 00"), 3, "not a date that exists"),
        (MAP.replace("0.00055000", "0.5", 1), 7, "ah, aw, zhd, zwd"),
        (MAP.replace("87.5   2.5 0", "87.5   7.5 0", 1), None, "expected a full grid"),
        (MAP[:-2], len(MAP.splitlines()), "no line end"),
    ],
)
def test_damaged_map(tmp_path: Path, text: str, line: int | None, words: str) -> None:
    path = written(tmp_path / "VMF3_bad.H00", text)
    with pytest.raises(FileFormatError, match=words) as caught:
        read_vmf3_grids([path], written(tmp_path / "orography", orography_text()))
    assert caught.value.line == line


def test_places_and_epochs_outside_maps(maps: tuple[list[Path], Path]) -> None:
    grids = read_vmf3_grids(*maps)
    with pytest.raises(CoverageError, match="the maps of VMF3"):
        grids.values_at(epochs_from_strings(["2024-01-01T06:30:00"], "UTC"), 0.5, 0.5, 0.0)
    with pytest.raises(InputError, match=r"-87.5 to 87.5"):
        grids.values_at(NEW_YEAR, np.deg2rad(89.0), 0.5, 0.0)


def test_gpt3_as_printed_by_the_authors_programs(tmp_path: Path) -> None:
    """gpt3_5.m, gpt3_5.f90 and gpt3_5_fast.py of TU Wien for MJD 60310.0, saasthyd.m and asknewet.m from these."""
    values = read_gpt3(written(tmp_path / "gpt3_5.grd", GPT3_CORNERS)).values_at(NEW_YEAR, *GRAZ)
    for name, printed, half_digit in (
        ("pressure_hpa", 959.59, 5e-3),
        ("vapour_pressure_hpa", 4.85, 5e-3),
        ("mean_temperature_k", 265.49, 5e-3),
        ("vapour_decrease_factor", 2.5189, 5e-5),
        ("hydrostatic_a", 0.00121094, 5e-9),
        ("wet_a", 0.00053970, 5e-9),
    ):
        np.testing.assert_allclose(getattr(values, name), [printed], rtol=0.0, atol=half_digit, err_msg=name)
    hydrostatic = zenith_hydrostatic_delay_m(values.pressure_hpa, *GRAZ[::2])
    wet = zenith_wet_delay_askne_nordius_m(
        values.vapour_pressure_hpa, values.mean_temperature_k, values.vapour_decrease_factor
    )
    np.testing.assert_allclose([hydrostatic, wet], [[2.1847], [0.0580]], rtol=0.0, atol=5e-5)


def climate(tmp_path: Path, change: dict[int, float]) -> Gpt3Grid:
    """Climate without seasons at all points: 1000 hPa, 280 K, dry, or as changed by column (from 0)."""
    row = np.zeros(64)
    row[[2, 7, 17, 22, 24, 29, 34, 39]] = 1e5, 280.0, -6.5, 40.0, 1.2, 0.5, 3.0, 270.0
    row[list(change)] = list(change.values())
    tail = " ".join(f"{value:g}" for value in row[2:])
    places = [(lat, lon) for lat in np.arange(-87.5, 88.0, 5.0) for lon in np.arange(2.5, 360.0, 5.0)]
    return read_gpt3(
        written(tmp_path / "synthetic.grd", "\n".join(f"{lat} {lon} {tail}" for lat, lon in places))
    )


def test_gpt3_of_air_at_rest(tmp_path: Path) -> None:
    """Barometric formula over 1000 m above a point 23 m above the geoid, which is 40 m above the ellipsoid."""
    values = climate(tmp_path, {23: 23.0}).values_at(NEW_YEAR, 0.3, -2.0, 1063.0)
    scale_height_m = 8.3143 * 280.0 / (9.80665 * 28.965e-3)
    np.testing.assert_allclose(values.pressure_hpa, [1000.0 * np.exp(-1000.0 / scale_height_m)], rtol=1e-12)
    np.testing.assert_allclose(values.vapour_pressure_hpa, [0.0])
    moist = climate(tmp_path, {12: 8.0})
    low, high = (moist.values_at(NEW_YEAR, 0.3, -2.0, height_m) for height_m in (40.0, 2040.0))
    np.testing.assert_allclose(low.vapour_pressure_hpa, [1000.0 * 0.008 / (0.622 + 0.378 * 0.008)])
    pressure_ratio = high.pressure_hpa / low.pressure_hpa
    np.testing.assert_allclose(high.vapour_pressure_hpa / low.vapour_pressure_hpa, pressure_ratio**4.0)


@pytest.mark.parametrize(
    ("column", "date", "expected_k"),
    [
        (40, "2024-01-01", np.cos(2 * np.pi / 365.25)),
        (41, "2023-04-01T06:00:00", np.sin(2 * np.pi * 91.25 / 365.25)),
        (42, "2023-04-01T06:00:00", np.cos(4 * np.pi * 91.25 / 365.25)),
        (43, "2023-02-14", np.sin(4 * np.pi * 45.0 / 365.25)),
    ],
)
def test_gpt3_seasons(tmp_path: Path, column: int, date: str, expected_k: float) -> None:
    values = climate(tmp_path, {column: 1.0}).values_at(epochs_from_strings([date], "UTC"), 0.3, -2.0, 40.0)
    np.testing.assert_allclose(values.mean_temperature_k, [270.0 + expected_k], rtol=1e-12)


@pytest.mark.parametrize(
    ("old", "new", "line", "words"),
    [
        ("89942", "8994x", 2, "'8994x' is not a number"),
        ("1.24073", "1240.73", 5, "thousandths"),
        (" 47.30 ", " 4.7e9 ", 2, "height in m"),
        ("  42.5   12.5", "  42.5   13.5", None, "expected a full grid"),
    ],
)
def test_damaged_gpt3(tmp_path: Path, old: str, new: str, line: int | None, words: str) -> None:
    path = written(tmp_path / "bad.grd", GPT3_CORNERS.replace(old, new))
    with pytest.raises(FileFormatError, match=words) as caught:
        read_gpt3(path)
    assert caught.value.line == line


def test_inconsistent_maps(tmp_path: Path, maps: tuple[list[Path], Path]) -> None:
    paths, orography = maps
    with pytest.raises(FileFormatError, match=r"MJD 60310.25.*H06"):
        read_vmf3_grids([paths[0], paths[0]], orography)
    regional = written(tmp_path / "VMF3.H12", "".join(vmf3_map_text(12).splitlines(keepends=True)[:-1]))
    with pytest.raises(FileFormatError, match="got other points"):
        read_vmf3_grids([paths[0], regional], orography)
    deep = orography_text().rstrip()[:-1].rsplit(maxsplit=1)[0] + " -99999\n"
    with pytest.raises(FileFormatError, match="got -99999"):
        read_vmf3_grids(paths, written(tmp_path / "deep", deep))
    with pytest.raises(FileFormatError, match="got 2591"):
        read_vmf3_grids(paths, written(tmp_path / "orography_ell_1x1", orography_text()[:-7]))
