"""Air above stations by files of VMF3 and GPT3: precedence of the sources, and missing files."""

import dataclasses

import numpy as np
import pytest
from legs import end
from mappings import vmf3

from radioloc.earth import StationCatalogue, geodetic_from_itrf
from radioloc.errors import CoverageError, InputError
from radioloc.media.air_files import Gpt3Grid
from radioloc.media.grids import LatLonGrid
from radioloc.media.mapping_functions import day_of_year
from radioloc.media.neutral_atmosphere import (
    water_vapour_pressure_hpa,
    zenith_hydrostatic_delay_m,
    zenith_wet_delay_askne_nordius_m,
)
from radioloc.media.radio_atmosphere import RadioAtmosphere, read_radio_atmosphere, zenith_air
from radioloc.time import epochs_from_strings, utc_to_tt

# 2020-12-02 is MJD 59185. Twice as much vapour at noon as at midnight; names as on the data server.
LINES = """\
SESHAN25  59185.50  0.00123000  0.00055000  2.3200  0.1200  1021.00  10.00  9.00
URUMQI    59185.50  0.00120000  0.00050000  1.8000  0.0200   795.00  -9.00  2.00
SESHAN25  59185.75  0.00124000  0.00057000  2.3300  0.2400  1023.00   9.00  9.50
URUMQI    59185.75  0.00121000  0.00052000  1.8100  0.0300   797.00 -11.00  1.50
"""
TT = utc_to_tt(epochs_from_strings(["2020-12-02T15:00:00", "2020-12-02T16:30:00"], "UTC"))
LATE = utc_to_tt(epochs_from_strings(["2020-12-02T18:30:00"] * 2, "UTC"))
SHARE = np.array([0.5, 0.75])
WEATHER = {"pressure_hpa": 1015.0, "temperature_k": 283.0, "relative_humidity": 0.6}
SHANGHAI = geodetic_from_itrf(StationCatalogue.default()["SESHAN25"].itrf_m)
PLACE = SHANGHAI.latitude_rad, SHANGHAI.longitude_rad, SHANGHAI.height_m
GRID = LatLonGrid(np.arange(-87.5, 88.0, 5.0), np.arange(2.5, 360.0, 5.0), "the grid")
SEASONAL = np.zeros((*GRID.shape, 12, 5))
SEASONAL[..., 0] = [1e5, 288.0, 6e-3, -6e-3, 1.22e-3, 5.4e-4, 2.8, 278.0, 0.0, 0.0, 0.0, 0.0]
CLIMATE = Gpt3Grid(GRID, SEASONAL, np.zeros(GRID.shape), np.zeros(GRID.shape))
"""Constant climate of 1000 hPa and 15 degrees Celsius at sea level."""


@pytest.fixture
def sites(tmp_path):
    path = tmp_path / "2020337.vmf3_r"
    path.write_text(LINES)
    return read_radio_atmosphere([path])


def air(files, station="SESHAN25", epoch=TT, **changes):
    return zenith_air(end(2, station, epoch=epoch, **changes), files)


def assert_mapped(zenith, a_h, a_w, height_m):
    """Compare the mapping functions with those of coefficients a and the height above their reference."""
    elevation_rad = np.array([0.3, 1.1])
    expected = vmf3(elevation_rad, a_h, a_w, *PLACE[:2], day_of_year(TT), height_m)
    np.testing.assert_allclose(zenith.mapping(elevation_rad, slice(None)), expected, rtol=1e-13)


def test_vmf3_of_a_site_between_epochs_of_utc(sites):
    """Epochs of TT would be wrong by 69 s; the wet delay grows by 0.12 m in six hours."""
    zenith = air(sites)
    np.testing.assert_allclose(zenith.hydrostatic_m, 2.32 + 0.01 * SHARE, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(zenith.wet_m, 0.12 + 0.12 * SHARE, rtol=0.0, atol=1e-9)
    assert_mapped(zenith, 1.23e-3 + 1e-5 * SHARE, 5.5e-4 + 2e-5 * SHARE, 0.0)


def test_recorded_pressure_takes_precedence(sites):
    plain, zenith = air(sites), air(sites, **WEATHER)
    expected_m = zenith_hydrostatic_delay_m(1015.0, SHANGHAI.latitude_rad, SHANGHAI.height_m)
    np.testing.assert_allclose(zenith.hydrostatic_m, expected_m, rtol=1e-15)
    np.testing.assert_array_equal(zenith.wet_m, plain.wet_m)
    np.testing.assert_array_equal(air(sites, pressure_hpa=1015.0).hydrostatic_m, zenith.hydrostatic_m)
    other_end = air(sites, has_weather=False, **WEATHER)
    np.testing.assert_array_equal(other_end.hydrostatic_m, plain.hydrostatic_m)


@pytest.mark.parametrize("weather", [{}, WEATHER], ids=["climate", "weather"])
def test_climate_with_and_without_weather(weather):
    zenith, values = air(RadioAtmosphere({}, None, CLIMATE), **weather), CLIMATE.values_at(TT, *PLACE)
    pressure, vapour = values.pressure_hpa, values.vapour_pressure_hpa
    if weather:
        pressure, vapour = 1015.0, water_vapour_pressure_hpa(283.0, 0.6, 1015.0)
    dry_m = zenith_hydrostatic_delay_m(pressure, *PLACE[::2])
    wet_m = zenith_wet_delay_askne_nordius_m(vapour, values.mean_temperature_k, values.vapour_decrease_factor)
    np.testing.assert_allclose(zenith.hydrostatic_m, dry_m, rtol=1e-14)
    np.testing.assert_allclose(zenith.wet_m, wet_m, rtol=1e-14)
    assert_mapped(zenith, 1.22e-3, 5.4e-4, SHANGHAI.height_m)


def test_other_stations_need_gpt3(sites):
    with pytest.raises(InputError, match=r"KASHI \(nor KS.*SESHAN25, URUMQI"):
        air(sites, "KASHI")
    combined, catalogue = dataclasses.replace(sites, gpt3=CLIMATE), StationCatalogue.default()
    assert [combined.source_of(catalogue[name]) for name in ("KASHI", "SESHAN25")] == ["GPT3", "VMF3"]
    assert (air(combined, "KASHI").hydrostatic_m > 1.9).all()
    # GPT3 is for stations that are not in the files, not for epochs.
    with pytest.raises(CoverageError, match=r"VMF3 of SESHAN25 covers") as caught:
        air(combined, epoch=LATE)
    assert caught.value.requested[0].startswith("2020-12-02 18.5")
