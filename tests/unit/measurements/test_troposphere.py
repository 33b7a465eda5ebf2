"""The troposphere at one end of a path, and why there is none where there is none."""

from __future__ import annotations

import numpy as np
import pytest
from arc_cases import LASER, epochs_tai, observations

from radioloc.earth.optical_troposphere import optical_delay
from radioloc.measurements.troposphere import SlantDelay, troposphere_delay
from radioloc.media.status import Status


class Place:
    """Only what the delay needs of a station."""

    def __init__(self, count):
        self.latitude_rad, self.height_m = np.full(count, 0.76), np.full(count, 1323.0)


def delay(elevation_deg, **changes):
    elevation_rad = np.radians(np.atleast_1d(elevation_deg))
    table = observations("GRASSE>x>GRASSE", epochs_tai(len(elevation_rad), 1.0), **(LASER | changes))
    radio = np.zeros(len(elevation_rad), dtype=bool)
    return troposphere_delay(table, Place(len(elevation_rad)), elevation_rad, radio, None)


def test_delay_is_that_of_the_optical_model():
    found = delay([10.0, 45.0, 90.0])
    expected = optical_delay(np.radians([10.0, 45.0, 90.0]), 780.0, 280.0, 0.3, 0.532, 0.76, 1323.0)
    assert found.delay_m.tolist() == expected.total_m.tolist()
    assert found.by_elevation_m_rad.tolist() == expected.elevation_rate_m_rad.tolist()
    assert found.status.tolist() == [Status.OK] * 3
    assert found.delay_m[2] == pytest.approx(1.85, abs=0.1)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"wavelength_um": np.nan}, "no wavelength"),
        ({"wavelength_um": 10.6}, "no troposphere model but for 0.3545-1.0645 um"),
        ({"wavelength_um": 0.3}, "no troposphere model but for"),
        ({"pressure_hpa": np.nan}, "no pressure"),
        ({"temperature_k": np.nan}, "no temperature"),
        ({"relative_humidity": np.nan}, "no humidity"),
    ],
)
def test_what_is_missing_is_named(changes, words):
    found = delay([30.0], **changes)
    assert words in Status(found.status[0]).text()
    assert found.delay_m.tolist() == [0.0]
    assert found.by_elevation_m_rad.tolist() == [0.0]


def test_one_row_does_not_spoil_another():
    found = delay([2.99, 30.0, 30.0], pressure_hpa=[780.0, np.nan, 780.0])
    assert found.status.tolist() == [Status.TOO_LOW, Status.NO_PRESSURE, Status.OK]
    assert found.delay_m.tolist()[:2] == [0.0, 0.0]
    assert found.delay_m[2] > 3.0


def test_none_is_no_delay_and_no_problem():
    none = SlantDelay.none(2)
    assert none.delay_m.tolist() == [0.0, 0.0]
    assert none.status.tolist() == [Status.OK] * 2
