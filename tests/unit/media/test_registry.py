"""Contract of registered media, and media that are registered at run time."""

import numpy as np
import pytest
from legs import leg

from radioloc.measurements import TERMS
from radioloc.media import MEDIA, LegDelay, Medium, Status
from radioloc.media.ionosphere import Ionosphere, UniformTec

ELEVATIONS_DEG = [-20.0, 1.0, 10.0, 45.0, 89.0]


@pytest.mark.parametrize("medium", [*MEDIA.values(), Ionosphere(UniformTec(20.0))], ids=lambda m: m.name)
def test_contract_of_media(medium):
    assert isinstance(medium, Medium)
    assert medium.name in TERMS
    assert TERMS[medium.name] == medium.description
    legs = leg(ELEVATIONS_DEG)
    result = medium.delay(legs, medium.prepare(legs.end))
    if result is None:
        return
    assert np.isfinite(result.delay_m).all()
    if result.status is not None:
        assert result.status.dtype == np.int8
        assert (result.delay_m[result.status != Status.OK] == 0.0).all()
    if result.by_elevation_m_rad is not None:
        step_deg = 1e-3
        ahead, behind = (
            medium.delay(moved, medium.prepare(moved.end)).delay_m
            for moved in (leg(np.add(ELEVATIONS_DEG, d)) for d in (step_deg, -step_deg))
        )
        numeric = (ahead - behind) / np.radians(2.0 * step_deg)
        np.testing.assert_allclose(result.by_elevation_m_rad, numeric, rtol=1e-5, atol=1e-6)


class Shield:
    """Delay of two millimetres at the zenith, zero without recorded pressure."""

    name, description, limits_rad = "shield", "a shield in front of the feed", ()

    def prepare(self, end):
        return np.where(np.isnan(end.weather.pressure_hpa), 0.0, 0.002)

    def delay(self, leg, prepared):
        sine = np.sin(leg.elevation.angle_rad)
        slope = -prepared * np.cos(leg.elevation.angle_rad) / sine**2
        return LegDelay(prepared / sine, by_elevation_m_rad=slope)


@pytest.fixture
def shield(monkeypatch):
    monkeypatch.setitem(MEDIA._entries, "shield", Shield())
