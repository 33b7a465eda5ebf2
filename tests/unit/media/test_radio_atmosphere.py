"""Files of VMF3 and GPT3 in the troposphere of radio signals: what goes before what, and what is not there."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from arc_cases import APOLLO15_PA_M
from legs import end
from mappings import vmf3

from radioloc.earth.geodesy import geodetic_from_itrf
from radioloc.earth.stations import StationCatalogue
from radioloc.errors import CoverageError, FileFormatError, InputError
from radioloc.measurements.chebyshev_predictor import ChebyshevPredictor
from radioloc.measurements.exact_predictor import ExactPredictor
from radioloc.measurements.link import Link
from radioloc.measurements.measurement_type import TIME_TAGS
from radioloc.measurements.observations import Observations
from radioloc.measurements.physical_model import PhysicalModel
from radioloc.measurements.registry import KINDS
from radioloc.media.air_files import Gpt3Grid, Vmf3Grids
from radioloc.media.grids import LatLonGrid
from radioloc.media.mapping_functions import day_of_year
from radioloc.media.neutral_atmosphere import (
    water_vapour_pressure_hpa,
    zenith_hydrostatic_delay_m,
    zenith_wet_delay_askne_nordius_m,
)
from radioloc.media.radio_atmosphere import RadioAtmosphere, air_above, read_radio_atmosphere
from radioloc.time import epochs_from_strings, tai_to_utc, utc_to_tai, utc_to_tt

SAME_M = 1e-6
"""The noise of two ranges of 8e8 m that are differenced."""

FOLLOWING_M = 1e-4
"""A delay of 7 m is 2e-8 s, after which events at 1 km/s are 2e-5 m elsewhere, on each of two legs."""

# 2020-12-02 is MJD 59185. Twice as much vapour at noon as at midnight; names as on the data server.
LINES = """\
SESHAN25  59185.50  0.00123000  0.00055000  2.3200  0.1200  1021.00  10.00  9.00
URUMQI    59185.50  0.00120000  0.00050000  1.8000  0.0200   795.00  -9.00  2.00
SESHAN25  59185.75  0.00124000  0.00057000  2.3300  0.2400  1023.00   9.00  9.50
URUMQI    59185.75  0.00121000  0.00052000  1.8100  0.0300   797.00 -11.00  1.50
"""
UTC = epochs_from_strings(["2020-12-02T15:00:00", "2020-12-02T16:30:00"])
SHARE = np.array([0.5, 0.75])
WEATHER = {"pressure_hpa": 1015.0, "temperature_k": 283.0, "relative_humidity": 0.6}
ENDS = ("URUMQI", "SESHAN25")


@pytest.fixture
def sites(tmp_path):
    path = tmp_path / "2020337.vmf3_r"
    path.write_text(LINES)
    return read_radio_atmosphere([path])


def climate():
    """The same everywhere and always: 1000 hPa and 15 degrees at sea level."""
    grid = LatLonGrid(np.arange(-87.5, 88.0, 5.0), np.arange(2.5, 360.0, 5.0), "the grid of GPT3")
    seasonal = np.zeros((*grid.shape, 12, 5))
    seasonal[..., 0] = [1e5, 288.0, 6e-3, -6e-3, 1.22e-3, 5.4e-4, 2.8, 278.0, 0.0, 0.0, 0.0, 0.0]
    return Gpt3Grid(grid, seasonal, np.zeros(grid.shape), np.zeros(grid.shape))


def maps():
    grid = LatLonGrid(np.arange(-87.5, 88.0, 5.0), np.arange(2.5, 360.0, 5.0), "the map of VMF3")
    values = np.broadcast_to([1.22e-3, 5.4e-4, 2.3, 0.1], (2, *grid.shape, 4)).copy()
    return Vmf3Grids(grid, np.array([59185.5, 59185.75]), values, np.zeros(grid.shape))


def arc_of(atmosphere, kind="range", ends=ENDS, utc=UTC, **columns):
    table = Observations.from_columns(
        epoch=utc,
        links=[Link(ends[0], "apollo15", ends[1], kind == "vlbi_delay")],
        value_m=1.0 if kind == "vlbi_delay" else 7e8,
        sigma_m=1.0,
        kind=KINDS.index(kind),
        tag=TIME_TAGS.index("receive"),
        **columns,
    )
    model = PhysicalModel.build(off=["ionosphere"], radio_atmosphere=atmosphere)
    return ExactPredictor(model, table, APOLLO15_PA_M)


def added_m(arc):
    """What the troposphere adds, and the elevations."""
    computed = arc.compute(APOLLO15_PA_M)
    without = ExactPredictor(arc.model.without("troposphere"), arc.observations, APOLLO15_PA_M)
    assert computed.usable.all()
    return computed.value_m - without.compute(APOLLO15_PA_M).value_m, computed.elevation_rad


def place_of(name):
    return geodetic_from_itrf(StationCatalogue.default()[name].itrf_m)


def factors(name, elevation_rad, a_h, a_w, above_m=0.0):
    place = place_of(name)
    day = day_of_year(utc_to_tt(UTC))
    return vmf3(elevation_rad, a_h, a_w, place.latitude_rad, place.longitude_rad, day, above_m)


def test_zenith_delays_and_coefficients_of_vmf3(sites):
    found_m, elevation_rad = added_m(arc_of(sites))
    up = factors("URUMQI", elevation_rad[:, 0], 1.20e-3 + 1e-5 * SHARE, 5.0e-4 + 2e-5 * SHARE)
    down = factors("SESHAN25", elevation_rad[:, 1], 1.23e-3 + 1e-5 * SHARE, 5.5e-4 + 2e-5 * SHARE)
    expected_m = (1.80 + 0.01 * SHARE) * up.hydrostatic + (0.02 + 0.01 * SHARE) * up.wet
    expected_m += (2.32 + 0.01 * SHARE) * down.hydrostatic + (0.12 + 0.12 * SHARE) * down.wet
    assert expected_m.min() > 5.0
    np.testing.assert_allclose(found_m, expected_m, rtol=0.0, atol=FOLLOWING_M)


def test_epochs_are_utc(sites):
    """Read as TT they would be 69 s off; the wet delay grows by 0.12 m in six hours."""
    air = air_above(dataclasses.replace(end(2, station="SESHAN25"), epoch=utc_to_tt(UTC)), sites)
    np.testing.assert_allclose(air.wet_m, 0.12 + 0.12 * SHARE, rtol=0.0, atol=1e-9)


def test_a_recorded_pressure_goes_before_and_belongs_to_the_receiver(sites):
    plain_m, elevation_rad = added_m(arc_of(sites))
    with_weather_m, _ = added_m(arc_of(sites, **WEATHER))
    pressure_alone_m, _ = added_m(arc_of(sites, pressure_hpa=1015.0))
    place = place_of("SESHAN25")
    zenith_m = zenith_hydrostatic_delay_m(1015.0, place.latitude_rad, place.height_m)
    down = factors("SESHAN25", elevation_rad[:, 1], 1.23e-3 + 1e-5 * SHARE, 5.5e-4 + 2e-5 * SHARE)
    changed_m = (zenith_m - (2.32 + 0.01 * SHARE)) * down.hydrostatic
    assert np.abs(changed_m).min() > 0.01
    np.testing.assert_allclose(with_weather_m - plain_m, changed_m, rtol=0.0, atol=FOLLOWING_M)
    np.testing.assert_allclose(pressure_alone_m, with_weather_m, rtol=0.0, atol=SAME_M)


def test_climate_with_and_without_weather():
    atmosphere = RadioAtmosphere({}, None, climate())
    for weather in ({}, WEATHER):
        found_m, elevation_rad = added_m(arc_of(atmosphere, **weather))
        expected_m = np.zeros(2)
        for k, name in enumerate(ENDS):
            place = place_of(name)
            values = climate().at(UTC, place.latitude_rad, place.longitude_rad, place.height_m)
            pressure, vapour = values.pressure_hpa, values.vapour_pressure_hpa
            if weather and name == "SESHAN25":
                pressure, vapour = 1015.0, water_vapour_pressure_hpa(283.0, 0.6, 1015.0)
            dry_m = zenith_hydrostatic_delay_m(pressure, place.latitude_rad, place.height_m)
            wet_m = zenith_wet_delay_askne_nordius_m(
                vapour, values.mean_temperature_k, values.vapour_decrease_factor
            )
            mapping = factors(name, elevation_rad[:, k], 1.22e-3, 5.4e-4, place.height_m)
            expected_m += dry_m * mapping.hydrostatic + wet_m * mapping.wet
        np.testing.assert_allclose(found_m, expected_m, rtol=0.0, atol=FOLLOWING_M)


def test_maps_serve_every_station():
    found_m, elevation_rad = added_m(arc_of(RadioAtmosphere({}, maps(), None)))
    expected_m = np.zeros(2)
    for k, name in enumerate(ENDS):
        place = place_of(name)
        values = maps().at(UTC, place.latitude_rad, place.longitude_rad, place.height_m)
        mapping = factors(name, elevation_rad[:, k], 1.22e-3, 5.4e-4, place.height_m)
        expected_m += values.zenith_hydrostatic_m * mapping.hydrostatic + values.zenith_wet_m * mapping.wet
    np.testing.assert_allclose(found_m, expected_m, rtol=0.0, atol=FOLLOWING_M)


def test_partials_by_time_and_by_zenith_delay(sites):
    arc = arc_of(sites, "vlbi_delay")
    computed = arc.compute(APOLLO15_PA_M)
    _, elevation_rad = added_m(arc)
    wet = factors("URUMQI", elevation_rad[:, 0], 1.2e-3, 5.0e-4 + 2e-5 * SHARE).wet
    np.testing.assert_allclose(computed.by_zenith_wet[:, 0], -wet, rtol=0.0, atol=1e-4)
    ahead, behind = (
        arc_of(sites, "vlbi_delay", utc=tai_to_utc(utc_to_tai(UTC).shifted(s))).compute(APOLLO15_PA_M).value_m
        for s in (0.5, -0.5)
    )
    # The files' own change with time is left out: 12 cm in six hours, mapped, 2e-5 m/s.
    np.testing.assert_allclose(computed.by_time_m_s, ahead - behind, rtol=0.0, atol=1e-4)


def test_dense_series_are_interpolated_over_the_files_epochs(tmp_path):
    """The air between epochs is linear, with a kink at each: here at 18 h."""
    path = tmp_path / "2020337.vmf3_r"
    late = LINES.replace("59185.50", "59186.00").replace("0.2400", "0.2000").splitlines()[:2]
    path.write_text(LINES + "\n".join(late) + "\n")
    start = utc_to_tai(epochs_from_strings(["2020-12-02T17:00:00"]))
    tai = start[np.zeros(600, dtype=int)].shifted(12.0 * np.arange(600))
    arc = arc_of(read_radio_atmosphere([path]), "vlbi_delay", utc=tai_to_utc(tai))
    dense = ChebyshevPredictor(arc.model, arc.observations, APOLLO15_PA_M)
    assert dense.accuracy.interpolated > 300
    found, exact = dense.compute(APOLLO15_PA_M), arc.compute(APOLLO15_PA_M)
    np.testing.assert_allclose(found.value_m, exact.value_m, rtol=0.0, atol=0.9e-4)


def test_parts_of_an_arc_keep_their_air(sites):
    whole = arc_of(sites)
    part = whole.select([1])
    assert part.compute(APOLLO15_PA_M).value_m == whole.compute(APOLLO15_PA_M).value_m[1:]


def test_other_stations_need_gpt3(sites):
    with pytest.raises(
        InputError, match=r"2020337\.vmf3_r: there is no station KASHI \(nor KS.*SESHAN25, URUMQI"
    ):
        arc_of(sites, ends=("KASHI", "SESHAN25"))
    both = dataclasses.replace(sites, gpt3=climate())
    catalogue = StationCatalogue.default()
    assert [both.source_of(catalogue[name]) for name in ("KASHI", "SESHAN25")] == ["GPT3", "VMF3"]
    found_m, elevation_rad = added_m(arc_of(both, ends=("KASHI", "SESHAN25")))
    assert found_m.min() > 2.0 / np.sin(elevation_rad).max()


def test_epochs_outside_the_files(sites):
    late = epochs_from_strings(["2020-12-02T18:30:00"])
    with pytest.raises(
        CoverageError, match=r"2020337\.vmf3_r, for station URUMQI: VMF3 of URUMQI covers"
    ) as caught:
        arc_of(sites, utc=late)
    assert caught.value.asked[0].startswith("2020-12-02 18.5")
    # GPT3 is for stations that are not in the files, not for epochs.
    with pytest.raises(CoverageError):
        arc_of(dataclasses.replace(sites, gpt3=climate()), utc=late)


def test_light_and_models_without_troposphere_ask_for_nothing(sites):
    late = epochs_from_strings(["2020-12-05T18:30:00"])
    arc = arc_of(sites, ends=("GRASSE", "GRASSE"), utc=late, wavelength_um=0.532, **WEATHER)
    bare = ExactPredictor(
        dataclasses.replace(arc.model, radio_atmosphere=None), arc.observations, APOLLO15_PA_M
    )
    assert arc.compute(APOLLO15_PA_M).value_m == bare.compute(APOLLO15_PA_M).value_m
    ExactPredictor(arc.model.without("troposphere"), arc_of(None, utc=late).observations, APOLLO15_PA_M)


def test_files_that_do_not_go_together(tmp_path):
    site_file, map_file = tmp_path / "y2020.vmf3_r", tmp_path / "VMF3_20201202.H12"
    site_file.write_text(LINES)
    map_file.write_text("! Version: 1.0\n! Data_types: VMF3 (lat lon ah aw zhd zwd)\n")
    with pytest.raises(InputError, match="neither"):
        read_radio_atmosphere()
    with pytest.raises(InputError, match="H12 is a map of VMF3: name the file of its heights"):
        read_radio_atmosphere([map_file])
    with pytest.raises(InputError, match="files of one kind"):
        read_radio_atmosphere([site_file, map_file], vmf3_orography=tmp_path / "orography_ell_5x5")
    with pytest.raises(InputError, match="goes with maps"):
        read_radio_atmosphere([site_file], vmf3_orography=tmp_path / "orography_ell_5x5")
    with pytest.raises(FileFormatError, match="no such file"):
        read_radio_atmosphere(gpt3=tmp_path / "gpt3_5.grd")
