"""Default sigmas of considered parameters, by the quality of their source, and those that a study states."""

from dataclasses import replace

import numpy as np
import pytest
from arc_cases import observed_at

from radioloc.constants import ARCSEC_RAD
from radioloc.earth.eop_prediction import last_measured_mjd
from radioloc.errors import InputError, PredictedEopWarning, StationError
from radioloc.measurements import FixedPoint, PhysicalModel, prepare_predictor
from radioloc.parameters.choice import parameter_choices
from radioloc.parameters.considered import considered_choices, resolve_considered
from radioloc.parameters.rows import ObservationRows
from radioloc.time import Epochs

PATHS = [
    ("range", "KASHI>lander>KASHI"),
    ("range", "JIAMUSI>lander>KASHI"),
    ("vlbi_delay", "SESHAN25<lander>URUMQI"),
    ("doppler", "KASHI>lander>KASHI"),
    ("doppler", "JIAMUSI>lander>KASHI"),
    ("vlbi_delay_rate", "SESHAN25<lander>URUMQI"),
    ("range", "WETTZELL>lander>WETTZELL"),
]
PLACE_PA_M = np.array([1.07e6, -1.02e6, 9.0e5])


def arc(model, paths=PATHS, day="2020-12-01", wavelength_um=35394.6):
    laser = np.array(["WETTZELL" in path for _, path in paths])
    observations = observed_at(
        [f"{day}T18:00:00"] * len(paths),
        [path for _, path in paths],
        link=np.arange(len(paths)),
        kind=[kind for kind, _ in paths],
        count_s=np.where([kind in ("doppler", "vlbi_delay_rate") for kind, _ in paths], 60.0, np.nan),
        wavelength_um=np.where(laser, 0.532, wavelength_um),
    )
    return prepare_predictor(model, observations, FixedPoint(PLACE_PA_M), "exact")


@pytest.fixture(scope="module")
def tracked(model):
    return arc(model)


def sigmas(predictor, stated=None, estimated=None, **options):
    choices, notes = resolve_considered(
        considered_choices(stated or {}),
        ObservationRows(predictor),
        parameter_choices(estimated or {}),
        **options,
    )
    return {name: choice.sigma for name, choice in choices.items()}, notes


def test_defaults_are_by_quality_of_the_source(tracked):
    result, notes = sigmas(tracked)
    assert notes == []
    assert result["station_position"] == {
        "KASHI": 100.0, "JIAMUSI": 100.0, "SESHAN25": 0.01, "URUMQI": 0.01, "WETTZELL": 0.01
    }  # fmt: skip
    assert result["clock"] == {"KASHI": 1e-8, "JIAMUSI": 1e-8, "SESHAN25": 2e-10, "URUMQI": 2e-10}
    assert result["clock_rate"] == {"SESHAN25": 5e-15, "URUMQI": 5e-15}
    # Two-way Doppler has no offset.
    assert result["frequency_offset"] == {"JIAMUSI>lander>KASHI": 1e-13, "SESHAN25<lander>URUMQI": 1e-14}
    of_radio = {"KASHI", "JIAMUSI", "SESHAN25", "URUMQI"}
    assert result["zenith_delay"] == dict.fromkeys(of_radio, 0.03)
    assert result["electron_content"] == dict.fromkeys(
        of_radio, 20.0
    )  # the model has an ionosphere, but no content
    of_light = {"WETTZELL": 0.01}
    assert result["range_bias"] == {"KASHI": pytest.approx(3.0, rel=1e-3)} | of_light
    assert result["transponder_delay"] == {"": 1e-8}
    assert result["ut1"][""] == pytest.approx(1e-5, rel=0.1)
    assert result["pole"][""] == pytest.approx(60e-6 * ARCSEC_RAD, rel=0.5)
    assert set(result) == {
        "station_position", "clock", "clock_rate", "frequency_offset", "zenith_delay", "electron_content",
        "ut1", "pole", "moon_position", "moon_position_variation", "libration", "libration_variation",
        "range_bias", "transponder_delay",
    }  # fmt: skip


def test_doppler_and_delays_have_no_range_errors(model):
    result, _ = sigmas(arc(model, PATHS[2:6]))
    assert not {"range_bias", "transponder_delay"} & result.keys()


@pytest.mark.parametrize("estimated", ["range_bias", "station_delay"])
def test_estimated_delay_of_a_station_replaces_its_considered_bias(tracked, estimated):
    result, _ = sigmas(tracked, estimated={estimated: ["KASHI"]})
    assert result["range_bias"] == {"WETTZELL": 0.01}
    assert result["transponder_delay"] == {"": 1e-8}


def test_estimated_bias_of_some_links_leaves_the_stations_of_others(tracked):
    three_way = {"range_bias": ["JIAMUSI>lander>KASHI"], "range_bias_per": "link"}
    assert "KASHI" in sigmas(tracked, estimated=three_way)[0]["range_bias"]
    of_kashi = three_way | {"range_bias": ["JIAMUSI>lander>KASHI", "KASHI>lander>KASHI"]}
    assert "KASHI" not in sigmas(tracked, estimated=of_kashi)[0]["range_bias"]


def test_older_ephemerides_have_larger_sigmas(model):
    paths = PATHS[:1]
    along_track_m = [
        sigmas(arc(model, paths, day))[0]["moon_position"][""][1] for day in ("2007-12-01", "2020-12-01")
    ]
    assert along_track_m == pytest.approx([1.06, 2.64], abs=0.01)
    newer = sigmas(arc(PhysicalModel.build(ephemeris="DE440", libration="DE440"), paths))[0]
    assert max(newer["moon_position"][""]) < 0.5
    assert max(newer["libration"][""]) < 1e-7


def test_predicted_earth_orientation_has_larger_sigmas(model):
    table = model.earth.table
    day = str(Epochs.from_jd(2400000.5 + last_measured_mjd(table) + 9.25, 0.0, "UTC").day_strings()[0])
    with pytest.warns(PredictedEopWarning):
        result, _ = sigmas(arc(model, PATHS[:1], day))
    # Bulletin A of 10 days: 0.0014 s, 0.0043 arcsec.
    assert result["ut1"][""] == pytest.approx(0.0014, rel=0.1)
    assert result["pole"][""] == pytest.approx(0.0043 * ARCSEC_RAD, rel=0.1)


def test_kinds_without_their_term_or_frequency_are_noted(model):
    result, notes = sigmas(arc(model.without("troposphere"), wavelength_um=np.nan))
    assert "electron_content" not in result
    assert "zenith_delay" not in result
    assert notes == [
        "zenith_delay is not considered: the term troposphere is switched off",
        "electron_content is not considered: the frequency of some signals is not recorded",
    ]


def test_study_overrides_defaults_by_kind_and_by_name(tracked):
    stated = {
        "station_position_sigma_m": {"KS": 0.1, "NEUQUEN": 0.2},  # an alias; one that observes nothing
        "clock_sigma_s": 5e-9,
        "ut1": "none",
        "range_bias": ["KASHI"],
        "range_bias_sigma_m": 2.0,
    }
    with_defaults, notes = sigmas(tracked, stated)
    assert notes == ["[consider] station_position: NEUQUEN has no observations, and the sigma no effect"]
    assert with_defaults["station_position"]["KASHI"] == 0.1
    assert with_defaults["station_position"]["JIAMUSI"] == 100.0
    assert set(with_defaults["clock"].values()) == {5e-9}
    assert "ut1" not in with_defaults
    assert with_defaults["range_bias"] == {"KASHI": 2.0}
    without_defaults, _ = sigmas(tracked, stated, defaults=False)
    assert set(without_defaults) == {"station_position", "clock", "range_bias"}
    assert set(sigmas(tracked, without_defaults=("libration",))[0]) == set(sigmas(tracked)[0]) - {"libration"}


def test_estimated_members_are_not_considered(tracked):
    result, _ = sigmas(
        tracked,
        estimated={
            "clock": "all",
            "station_position": ["KASHI"],
            "zenith_delay": ["URUMQI"],
            "zenith_delay_per": "station",
            "frequency_offset": ["KASHI"],
            "frequency_offset_per": "pass",
        },
    )
    assert "clock" not in result  # nor is the station that the others' clocks refer to
    assert "KASHI" not in result["station_position"]
    assert "URUMQI" not in result["zenith_delay"]
    assert "frequency_offset" not in result


def test_names_and_sigmas_are_checked(tracked):
    with pytest.raises(StationError, match="not in the catalogue"):
        sigmas(tracked, {"clock_sigma_s": {"NOWHERE": 1e-9}})
    with pytest.raises(InputError, match=r"clock_rate_sigma_s_s.*KASHI"):
        sigmas(tracked, {"clock_rate": ["KASHI"]})


def test_sigma_of_a_station_in_the_catalogue(model):
    catalogue = model.catalogue.with_station(replace(model.catalogue.get("KASHI"), sigma_m=0.3))
    result, _ = sigmas(arc(PhysicalModel.build(catalogue=catalogue)))
    assert result["station_position"]["KASHI"] == 0.3
    with pytest.raises(StationError, match="sigma_m"):
        replace(model.catalogue.get("KASHI"), sigma_m=0.0)
