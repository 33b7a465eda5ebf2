"""Legs of light paths by hand: station at the origin, target to the north."""

from types import SimpleNamespace

import numpy as np

from radioloc.earth.stations import StationCatalogue
from radioloc.media.medium import Leg, LegEnd
from radioloc.time import epochs_from_strings, utc_to_tt

DISTANCE_M = 3.8e8


def rows(values):
    """Return an array of one row."""
    return np.array([values], dtype=np.float64)


def state(up=(0.0, 0.0, 1.0), gcrs_m=(0.0, 0.0, 0.0), velocity=(0.0, 0.0, 0.0), up_rate=(0.0, 0.0, 0.0), n=1):
    """Return equal states of n stations."""
    return SimpleNamespace(
        gcrs_m=np.repeat(rows(gcrs_m), n, axis=0),
        gcrs_velocity_m_s=np.repeat(rows(velocity), n, axis=0),
        up_gcrs=np.repeat(rows(up), n, axis=0),
        up_rate_gcrs=np.repeat(rows(up_rate), n, axis=0),
        pole_gcrs=np.repeat(rows((0.6, 0.0, 0.8)), n, axis=0),
        latitude_rad=np.full(n, 0.76),
        height_m=np.full(n, 1323.0),
    )


def end(n, station="KASHI", **changes):
    """Return ends of legs at one station: radio of 8.4 GHz without recorded weather, and changes."""
    weather = {
        name: np.broadcast_to(np.float64(changes.pop(name, np.nan)), n)
        for name in ("pressure_hpa", "temperature_k", "relative_humidity")
    }
    columns = {
        "stations": [StationCatalogue.default()[station]],
        "station_index": np.zeros(n, dtype=np.int32),
        "epoch": changes.pop("epoch", None)
        or utc_to_tt(epochs_from_strings(["2020-12-02T14:00:00"] * n, "UTC")),
        "radio": np.ones(n, dtype=bool),
        "phase": np.zeros(n, dtype=bool),
        "frequency_hz": np.full(n, 8.4e9),
        "wavelength_um": np.full(n, np.nan),
        "weather": SimpleNamespace(**weather),
        "has_weather": np.ones(n, dtype=bool),
    }
    return LegEnd(**columns | {name: np.broadcast_to(v, n) for name, v in changes.items()})


def leg(elevation_deg, **changes):
    """Return legs at elevations."""
    angle = np.radians(np.atleast_1d(elevation_deg))
    target_m = DISTANCE_M * np.stack([np.cos(angle), np.zeros(len(angle)), np.sin(angle)], axis=-1)
    return Leg(end(len(angle), **changes), state(n=len(angle)), target_m, np.zeros((len(angle), 3)))
