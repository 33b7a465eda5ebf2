"""Schedules: exact epochs, links by kind, visibility."""

import numpy as np
import pytest

from radioloc.errors import InputError
from radioloc.simulation import Masks, Schedule, Session, all_ranges, elevations, two_way, windows
from radioloc.time import epochs_from_strings, utc_strings, utc_to_tt

RANGERS = ("JIAMUSI", "KASHI", "NEUQUEN")
START, STOP = "2020-12-01T15:11:00", "2020-12-03T15:10:00"


def test_epochs_are_the_nearest_floats_of_the_dates():
    epochs = Session("range", two_way("KASHI"), START, STOP, 60.0, 1.0).epochs()
    assert len(epochs) == 2880
    texts = utc_strings(epochs).tolist()
    assert (texts[0], texts[-1]) == ("2020-12-01T15:11:00.000000000", "2020-12-03T15:10:00.000000000")
    parsed = epochs_from_strings(texts, "UTC")
    assert (parsed.jd == epochs.jd).all()
    assert (parsed.fraction == epochs.fraction).all()
    tenths = Session("range", two_way("KASHI"), "2020-12-01T23:59:59", "2020-12-02T00:00:00.95", 0.1, 1.0)
    assert utc_strings(tenths.epochs()[[9, 10, -1]], decimals=3).tolist() == [
        "2020-12-01T23:59:59.900",
        "2020-12-02T00:00:00.000",
        "2020-12-02T00:00:00.900",
    ]


def test_all_epochs_above_the_masks_are_measured(model, lander, lander_pa_m, compute):
    masks = Masks(10.0, by_station_deg={"NEUQUEN": 20.0})
    session = Session("range", two_way(*RANGERS), START, STOP, 60.0, 1.0)
    observations = Schedule([session], masks).plan(model, lander).observations
    by_model = compute(model, observations, lander_pa_m)
    assert by_model.usable.all()
    for name in RANGERS:
        rows = np.array([link.receiver == name for link in observations.links])[observations.link]
        # The elevation at transmission differs by 2 arcsec in the model.
        assert np.degrees(by_model.elevation_rad[rows]).min() > masks.for_station(name) - 1e-3
        visible_s = sum(
            60.0 * len(Session("range", two_way(name), w.start_utc, w.stop_utc, 60.0, 1.0).epochs())
            for w in windows(model, lander, [name], START, STOP, masks)
        )
        # Up to one epoch at each rise and set.
        assert abs(60.0 * rows.sum() - visible_s) <= 60.0 * 6


def test_mask_at_the_target_removes_epochs(model, lander):
    session = Session("range", two_way("KASHI"), START, STOP, 600.0, 1.0)
    unmasked = Schedule([session]).plan(model, lander).observations
    at_target = elevations(model, lander, ["KASHI"], utc_to_tt(unmasked.epoch)).at_target_rad
    middle_deg = float(np.degrees(np.median(at_target)))
    masked = Schedule([session], Masks(target_deg=middle_deg)).plan(model, lander).observations
    assert 0.4 < len(masked) / len(unmasked) < 0.6


def test_one_station_transmits_at_a_time(model, lander):
    session = Session("range", all_ranges(*RANGERS), START, STOP, 60.0, 1.0, one_uplink=True)
    observations = Schedule([session], Masks(5.0)).plan(model, lander).observations
    keys = np.round(observations.epoch.mjd * 1440.0).astype(int)
    senders = np.array([RANGERS.index(link.transmitter) for link in observations.links])[observations.link]
    for key in np.unique(keys):
        assert len(set(senders[keys == key].tolist())) == 1
    assert set(senders.tolist()) == {0, 1, 2}
    # The second station transmits only while the target is below the mask of the first.
    first = Schedule([Session("range", two_way("JIAMUSI"), START, STOP, 60.0, 1.0)], Masks(5.0))
    minutes = np.round(first.plan(model, lander).observations.epoch.mjd * 1440.0).astype(int)
    assert set(minutes.tolist()) == set(keys[senders == 0].tolist())
    assert {"JIAMUSI>lander>KASHI", "KASHI>lander>NEUQUEN"} < set(observations.paths().tolist())


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"kind": "delay"}, "kind: .* 'delay'"),
        ({"kind": "vlbi_delay"}, "two different stations"),
        ({"pairs": ()}, "pairs: expected"),
        ({"sigma_m": np.nan}, "sigma_m: .* nan"),
        ({"time_tag": "reflect"}, "time_tag: .* 'reflect'"),
    ],
)
def test_invalid_sessions_are_refused(changes, words):
    fields = {
        "kind": "range",
        "pairs": two_way("KASHI"),
        "start_utc": START,
        "stop_utc": STOP,
        "step_s": 60.0,
        "sigma_m": 1.0,
    }
    with pytest.raises(InputError, match=words):
        Session(**(fields | changes))
