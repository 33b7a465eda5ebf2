import gzip
from pathlib import Path

import numpy as np
import pytest
from atmosphere_files import VMF3_SITES, orography_text, vmf3_map_text

from radioloc.errors import CoverageError, FileFormatError, InputError
from radioloc.media.air_files import read_vmf3_grids, read_vmf3_sites
from radioloc.media.neutral_atmosphere import zenith_hydrostatic_delay_m
from radioloc.time import epochs_from_strings, utc_to_tt

WITH_GRADIENTS = """\
ADEA      58496.00  0.00120787  0.00065184  2.2275  0.0626   979.44  -3.07   2.67  -0.406   0.051   0.112   0.023
ADEA      58496.25  0.00120787  0.00065184  2.2275  0.0626   979.44  -3.07   2.67  -0.206   0.051   0.112   0.025
"""


def written(path: Path, text: str) -> Path:
    path.write_text(text)
    return path


@pytest.fixture
def sites(tmp_path: Path) -> Path:
    return written(tmp_path / "2024001.vmf3_r", VMF3_SITES)


def test_site_at_and_between_epochs(sites: Path) -> None:
    series = read_vmf3_sites([sites])
    assert set(series) == {"GRAZ", "WETTZELL"}
    graz = series["GRAZ"]
    values = graz.at(
        epochs_from_strings(
            ["2024-01-01", "2024-01-01T03:00:00", "2024-01-01T07:30:00", "2024-01-01T12:00:00"]
        )
    )
    np.testing.assert_allclose(
        values.hydrostatic_a, [1.2048e-3, 1.19953e-3, 1.195035e-3, 1.19736e-3], rtol=1e-12
    )
    np.testing.assert_allclose(values.wet_a, [5.8178e-4, 5.5306e-4, 5.0274e-4, 4.3794e-4], rtol=1e-12)
    np.testing.assert_allclose(values.zenith_hydrostatic_m, [2.1686, 2.17045, 2.173625, 2.1776], rtol=1e-12)
    np.testing.assert_allclose(values.zenith_wet_m, [0.1047, 0.08765, 0.066325, 0.0535], rtol=1e-12)
    assert values.height_above_a_m == 0.0


def test_any_time_scale(sites: Path) -> None:
    utc = epochs_from_strings(["2024-01-01T04:00:00"])
    graz = read_vmf3_sites([sites])["GRAZ"]
    np.testing.assert_allclose(graz.at(utc).wet_a, graz.at(utc_to_tt(utc)).wet_a, rtol=1e-12)


def test_zenith_delay_of_the_file_is_that_of_its_pressure(sites: Path) -> None:
    """GRAZ stands 538.30 m above the ellipsoid at 47.0671 degrees."""
    graz = read_vmf3_sites([sites])["GRAZ"]
    computed = zenith_hydrostatic_delay_m(np.array([951.19, 953.07, 955.28]), np.deg2rad(47.0671), 538.30)
    # The server integrates the column with other constants of refractivity: 2.4 to 3.0 mm more here.
    np.testing.assert_allclose(graz.values[:, 2] - computed, 0.0027, atol=4e-4)


def test_days_join_in_any_order_and_gzip(sites: Path, tmp_path: Path) -> None:
    later = tmp_path / "2024002.vmf3_r"
    later.write_bytes(gzip.compress(VMF3_SITES.replace("60310", "60311").encode()))
    series = read_vmf3_sites([later, sites])["GRAZ"]
    np.testing.assert_array_equal(series.mjd_utc, [60310.0, 60310.25, 60310.5, 60311.0, 60311.25, 60311.5])
    assert len(series.at(epochs_from_strings(["2024-01-01T12:00:00", "2024-01-02T00:00:00"])).wet_a) == 2
    with pytest.raises(CoverageError, match=r"lacks epochs, covers .* 12.0 h UTC and from 2024-01-02 00.0 h"):
        series.at(epochs_from_strings(["2024-01-01T12:00:01"]))


def test_gradients_are_left_aside(tmp_path: Path) -> None:
    path = written(tmp_path / "2019013.v3gr_d", WITH_GRADIENTS)
    noon = epochs_from_strings(["2019-01-13T03:00:00"])
    assert read_vmf3_sites([path])["ADEA"].at(noon).zenith_hydrostatic_m == pytest.approx(2.2275, rel=1e-12)


@pytest.mark.parametrize("date", ["2023-12-31T23:59:00", "2024-01-01T12:00:01"])
def test_outside_the_files(sites: Path, date: str) -> None:
    with pytest.raises(
        CoverageError, match=r"VMF3 of GRAZ covers 2024-01-01 00.0 h UTC to 2024-01-01 12.0 h UTC"
    ):
        read_vmf3_sites([sites])["GRAZ"].at(epochs_from_strings([date]))


@pytest.mark.parametrize(
    ("old", "new", "line", "what"),
    [
        ("0.00119426", "0.0011x", 4, "'0.0011x' is not a number"),
        ("# ", "# VMF1 ", 1, "expected VMF3, got VMF1"),
        ("0.00119426", "nan", 4, "'nan' is not a number"),
        ("0.00119426", "1.19426", 4, "ah, aw, zhd, zwd are 1.19426"),
        ("2.1723", "2172.3", 4, "2172.3, 0.0706; near"),
        ("  953.07", "", 4, "8 columns"),
        ("953.07", "95307", 4, "p, T, e are 95307, 3.26, 6.49; hPa"),
        ("  3.26", "276.41", 4, "p, T, e are 953.07, 276.41, 6.49; hPa"),
        ("60310.25  0.00119426", "60310.00  0.00119426", 4, "GRAZ has the epoch MJD 60310.00 twice"),
    ],
)
def test_damaged_file_of_sites(tmp_path: Path, old: str, new: str, line: int, what: str) -> None:
    path = written(tmp_path / "bad.vmf3_r", VMF3_SITES.replace(old, new))
    with pytest.raises(FileFormatError, match=what) as caught:
        read_vmf3_sites([path])
    assert caught.value.line == line


def test_a_file_of_sites_that_was_cut_gives_no_other_values(tmp_path: Path) -> None:
    """Wherever it is cut: the same values at an epoch, or an error there."""
    whole = read_vmf3_sites([written(tmp_path / "whole", VMF3_SITES)])
    start = VMF3_SITES.index("GRAZ")
    refused = same = 0
    for length in range(start + 1, len(VMF3_SITES), 3):
        path = written(tmp_path / "cut", VMF3_SITES[:length])
        try:
            cut = read_vmf3_sites([path])
        except FileFormatError:
            continue
        for station in cut:
            epoch = epochs_from_strings(["2024-01-01T08:00:00"])
            try:
                found = cut[station].at(epoch)
            except CoverageError:
                refused += 1
                continue
            np.testing.assert_array_equal(found.zenith_wet_m, whole[station].at(epoch).zenith_wet_m)
            same += 1
    assert refused > 0
    assert same > 0


def test_nothing_to_read(tmp_path: Path) -> None:
    with pytest.raises(FileFormatError, match="is empty"):
        read_vmf3_sites([written(tmp_path / "empty", "\n")])
    with pytest.raises(FileFormatError, match="no line of a station"):
        read_vmf3_sites([written(tmp_path / "comments", "# nothing\n")])


@pytest.fixture
def maps(tmp_path: Path) -> tuple[list[Path], Path]:
    paths = [written(tmp_path / f"VMF3_20240101.H{hour:02d}", vmf3_map_text(hour)) for hour in (6, 0)]
    return paths, written(tmp_path / "orography_ell_5x5", orography_text())


def test_map_in_space_and_time(maps: tuple[list[Path], Path]) -> None:
    grids = read_vmf3_grids(*maps)
    epochs = epochs_from_strings(["2024-01-01T00:00:00", "2024-01-01T03:00:00", "2024-01-01T06:00:00"])
    for latitude_deg, longitude_deg in ((35.0, 0.0), (-20.0, -116.9), (87.5, 355.0)):
        values = grids.at(epochs, np.deg2rad(latitude_deg), np.deg2rad(longitude_deg), 300.0)
        expected = 1.2e-3 + 1e-6 * latitude_deg + 1e-6 * np.array([0.0, 3.0, 6.0])
        np.testing.assert_allclose(values.hydrostatic_a, expected, rtol=1e-10)
        np.testing.assert_allclose(values.wet_a, 5.5e-4)
        assert values.height_above_a_m == 300.0
        # At the map's own height nothing changes.
        np.testing.assert_allclose(values.zenith_hydrostatic_m, 2.2, rtol=1e-12)
        np.testing.assert_allclose(values.zenith_wet_m, 0.1, rtol=1e-12)


def test_zenith_delays_are_taken_to_the_height(maps: tuple[list[Path], Path]) -> None:
    grids = read_vmf3_grids(*maps)
    values = grids.at(epochs_from_strings(["2024-01-01"]), 0.6, 1.0, 1300.0)
    # Kouba (2008): by way of the pressure that gives 2.2 m at 300 m.
    pressure_hpa = 2.2 / zenith_hydrostatic_delay_m(1.0e3, 0.6, 300.0) * 1.0e3
    above_hpa = pressure_hpa * (1.0 - 2.26e-5 * 1000.0) ** 5.225
    expected = zenith_hydrostatic_delay_m(above_hpa, 0.6, 1300.0)
    np.testing.assert_allclose(values.zenith_hydrostatic_m, expected, rtol=1e-12)
    np.testing.assert_allclose(values.zenith_wet_m, 0.1 * np.exp(-0.5), rtol=1e-12)


def test_map_with_gradients_and_along_a_parallel(tmp_path: Path, maps: tuple[list[Path], Path]) -> None:
    paths = [
        written(tmp_path / f"V3GR.H{hour:02d}", vmf3_map_text(hour, "V3GR", 0.05, " 0.1 0.2 0.3 0.4"))
        for hour in (0, 6)
    ]
    grids = read_vmf3_grids(paths, maps[1])
    epoch = epochs_from_strings(["2024-01-01T01:00:00"])
    # Across the meridian of Greenwich the chord over 5 degrees is 1e-3 below the cosine.
    for longitude_deg, crest_deg in ((0.0, 2.5), (92.5, 92.5), (182.5, 182.5)):
        values = grids.at(epoch, 0.5, np.deg2rad(longitude_deg), 300.0)
        expected_m = 0.1 + 0.05 * np.cos(np.deg2rad(crest_deg))
        np.testing.assert_allclose(values.zenith_wet_m, expected_m, rtol=0.0, atol=1e-6)


@pytest.mark.parametrize(
    ("text", "line", "what"),
    [
        (vmf3_map_text(0).replace("VMF3 (", "VMF1 ("), 2, "VMF1 go with other b and c"),
        (vmf3_map_text(0).replace("! Epoch", "! Epic"), None, "no line '! Epoch:'"),
        (vmf3_map_text(0).replace("01 01 00 00", "13 01 00 00"), 3, "not a date that exists"),
        (vmf3_map_text(0).replace("01 01 00 00", "01 01 00"), 3, "year month day hour minute second"),
        (vmf3_map_text(0).replace("1.e+00", "1.e-03"), 4, "scale factor is 1.e-03"),
        (vmf3_map_text(0).replace("0.00055000", "0.00x", 1), 7, "'0.00x' is not a number"),
        (vmf3_map_text(0).replace("0.00055000", "0.5", 1), 7, "ah, aw, zhd, zwd are"),
        (vmf3_map_text(0).replace("0.00055000", "", 1), 7, "5 columns"),
        (vmf3_map_text(0).replace("87.5   2.5 0", "87.5   7.5 0", 1), None, "do not fill a grid"),
        ("".join(vmf3_map_text(0).splitlines(keepends=True)[:6]), None, "no point"),
        (vmf3_map_text(0)[:-2], len(vmf3_map_text(0).splitlines()), "the last line has no line end"),
    ],
)
def test_damaged_map(tmp_path: Path, text: str, line: int | None, what: str) -> None:
    path = written(tmp_path / "VMF3_bad.H00", text)
    with pytest.raises(FileFormatError, match=what) as caught:
        read_vmf3_grids([path], written(tmp_path / "orography", orography_text()))
    assert caught.value.line == line


def test_maps_that_do_not_go_together(tmp_path: Path, maps: tuple[list[Path], Path]) -> None:
    paths, orography = maps
    with pytest.raises(FileFormatError, match=r"has the epoch MJD 60310.25 of .*H06"):
        read_vmf3_grids([paths[0], paths[0]], orography)
    other = written(tmp_path / "VMF3.H12", "".join(vmf3_map_text(12).splitlines(keepends=True)[:-1]))
    with pytest.raises(FileFormatError, match="has other points than"):
        read_vmf3_grids([paths[0], other], orography)
    deep = written(
        tmp_path / "orography_of_sea", orography_text().rstrip()[:-1].rsplit(maxsplit=1)[0] + " -99999\n"
    )
    with pytest.raises(FileFormatError, match="heights of the ground from -1000 to 10000 m, got -99999"):
        read_vmf3_grids(paths, deep)
    short = written(tmp_path / "orography_ell_1x1", orography_text()[:-7])
    with pytest.raises(FileFormatError, match="has 2591 heights, but the map has 2592 points"):
        read_vmf3_grids(paths, short)


def test_map_asked_for_what_it_has_not(maps: tuple[list[Path], Path]) -> None:
    grids = read_vmf3_grids(*maps)
    with pytest.raises(CoverageError, match="the maps of VMF3 covers"):
        grids.at(epochs_from_strings(["2024-01-01T06:30:00"]), 0.5, 0.5, 0.0)
    epochs = epochs_from_strings(["2024-01-01T05:30:00"])
    with pytest.raises(InputError, match=r"reaches from latitude -87.5 to 87.5"):
        grids.at(epochs, np.deg2rad(89.0), 0.5, 0.0)
