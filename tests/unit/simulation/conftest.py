import pytest

from radioloc.lunar.position import LunarPosition
from radioloc.measurements import ExactPredictor, FixedPoint, PhysicalModel


@pytest.fixture(scope="session")
def model():
    return PhysicalModel.build(off=["troposphere"])


@pytest.fixture(scope="session")
def lander():
    return LunarPosition.from_selenographic(-51.9162, 43.0584, -2550.4)


@pytest.fixture(scope="session")
def lander_pa_m(lander, model):
    return lander.to_axes("PA", model.ephemeris.constants).xyz_m


@pytest.fixture(scope="session")
def compute():
    """Predict observations by the measurement model."""

    def predicted(model, observations, target_pa_m):
        return ExactPredictor(model, observations, FixedPoint(target_pa_m)).compute()

    return predicted


@pytest.fixture(scope="session")
def predict_m(compute):
    """Predict values by the measurement model."""
    return lambda model, observations, target_pa_m: compute(model, observations, target_pa_m).value_m
