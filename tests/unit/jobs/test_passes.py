"""Passes of a study's target: against elevations, with the limits that the study says."""

import numpy as np
import pytest
from paths import EXAMPLES

import radioloc
from radioloc import visibility
from radioloc.errors import InputError, StationError
from radioloc.jobs.preparation import build_model
from radioloc.simulation import elevations
from radioloc.time import epochs_from_strings, utc_to_tt

PLAN = EXAMPLES / "change5" / "simulation.toml"
SECOND_DEG = 15.1 / 3600.0
"""No elevation changes by more in a second."""
MINUTE_DEG = 2e-4
"""By how much the highest at whole minutes may be below the highest."""


@pytest.fixture(scope="module")
def plan():
    return radioloc.read_study(PLAN)


def elevation_deg(study, station, utc):
    model = build_model(study)
    tt = utc_to_tt(epochs_from_strings(utc, "UTC"))
    return np.degrees(elevations(model, study.simulation.position, [station], tt).at_station_rad[:, 0])


@pytest.mark.study
def test_a_target_rises_and_sets_at_the_masks_of_the_schedule(plan):
    result = visibility(plan)
    assert (result.start_utc, result.stop_utc) == ("2020-12-01T15:11:00", "2020-12-03T15:10:00")
    assert set(result.masks_deg.values()) == {10.0, 15.0}
    edges = [(item.station, item.start_utc) for item in result.passes if item.rises]
    edges += [(item.station, item.stop_utc) for item in result.passes if item.sets]
    assert len(edges) > 20
    for station, utc in edges:
        above_deg = elevation_deg(plan, station, [utc])[0] - result.masks_deg[station]
        assert above_deg + 0.1 * SECOND_DEG >= 0.0
        assert above_deg < 1.1 * SECOND_DEG


def test_the_highest_elevation_of_a_pass_is_that(plan):
    [item] = visibility(plan, ["NM"], stop_utc="2020-12-02T12:00:00").passes
    assert (item.station, item.rises, item.sets) == ("NEUQUEN", True, True)
    start = np.datetime64(item.start_utc)
    seconds = (np.datetime64(item.stop_utc) - start).astype(int)
    assert item.hours == pytest.approx(seconds / 3600.0, abs=1e-9)
    dense_deg = elevation_deg(plan, "NEUQUEN", (start + np.arange(0, seconds, 10)).astype(str).tolist())
    assert abs(dense_deg.max() - item.highest_deg) < MINUTE_DEG
    assert elevation_deg(plan, "NEUQUEN", [item.highest_utc])[0] == pytest.approx(
        item.highest_deg, abs=SECOND_DEG
    )


def test_of_data_the_stations_and_the_span_are_those_of_the_observations():
    result = visibility(EXAMPLES / "apollo15" / "apollo15.toml", stop_utc="2006-04-08")
    assert (result.start_utc, list(result.masks_deg)) == ("2006-04-07T06:26:30", ["APOLLO"])
    # What was measured then was seen.
    assert result.passes[0].highest_deg > 10.0
    assert not result.passes[0].rises


def test_antennas_of_a_complex_and_the_missing_terrain_are_noted(plan):
    result = visibility(plan, ["GOLDSTONE", "KASHI"], stop_utc="2020-12-01T16:11:00")
    antennas, horizon = result.notes
    assert "DSS-13, DSS-14, DSS-15" in antennas
    assert "target_mask_deg" in horizon
    assert "KASHI" not in antennas
    assert antennas in " ".join(str(result).split())
    catalogue = radioloc.earth.StationCatalogue.default()
    assert catalogue.antenna_notes(["DSS-24", "DSS-25", "KASHI", "JIAMUSI", "NEUQUEN"]) == []


def test_what_cannot_be_searched(plan):
    with pytest.raises(StationError, match="NOPE"):
        visibility(plan, ["NOPE"])
    with pytest.raises(InputError, match="stop_utc:"):
        visibility(plan, start_utc="2020-12-05")
    with pytest.raises(InputError, match=r"-90.*90"):
        visibility(plan, mask_deg=100.0)


def test_single_station_is_its_name():
    study = EXAMPLES / "change5" / "short_arc.toml"
    span = {"start_utc": "2020-12-02", "stop_utc": "2020-12-03"}
    single, several = visibility(study, "KASHI", **span), visibility(study, ["KASHI"], **span)
    assert single.passes == several.passes
