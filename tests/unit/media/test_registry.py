"""Contract of registered media, and media that are registered at run time."""

import numpy as np
import pytest
from arc_cases import APOLLO15, LASER, epochs_tai, observations
from legs import leg

from radioloc.errors import InputError
from radioloc.measurements import TERMS, ChebyshevPredictor, ExactPredictor, PhysicalModel
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


def test_registered_medium_is_a_term(shield):
    model = PhysicalModel.build()
    table = observations("GRASSE>x>GRASSE", epochs_tai(3, 1.0, 2460311.5, 0.1), **LASER)
    arc = ExactPredictor(model, table, APOLLO15)
    computed = arc.compute()
    terms = arc.terms()
    assert list(terms)[-1] == "shield"
    np.testing.assert_allclose(
        terms["shield"], 0.002 * (1.0 / np.sin(computed.elevation_rad)).sum(axis=-1), atol=1e-6
    )
    assert [medium.name for medium in model.without("shield").media] == [
        "troposphere",
        "ionosphere",
        "antenna_axis_offset",
    ]
    with pytest.raises(InputError, match="'shield'"):
        model.without("shields")


def test_conditions_used_by_a_registered_medium_separate_series(shield):
    tai = epochs_tai(600, 1.0, 2460311.5, 0.1)
    weather = LASER | {"pressure_hpa": np.where(np.arange(600) % 2, 780.0, np.nan)}
    table = observations("GRASSE>x>GRASSE", tai, **weather)
    model = PhysicalModel.build(off=["troposphere"])
    dense, exact = (kind(model, table, APOLLO15) for kind in (ChebyshevPredictor, ExactPredictor))
    assert dense.accuracy.interpolated > 0
    difference_m = dense.compute().value_m - exact.compute().value_m
    assert np.abs(difference_m).max() < 0.9e-4
