"""Powered descent to the Moon as a study: from 15 km to the ground in twelve minutes, tracked by three stations."""

from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np

from radioloc.dynamics import Acceleration, Forces, GravityField, propagate
from radioloc.ephemeris import LunarOrientation
from radioloc.lunar import LunarPosition, rot_icrf_to_pa
from radioloc.lunar.frames import rot_icrf_to_pa_rate
from radioloc.time import epochs_from_strings, utc_strings

TOUCHDOWN = "2020-12-01T15:11:09"  # TDB
SITE = (-51.9162, 43.0584, -2550.4)
TDB_LESS_UTC_S = 69.184
STATIONS = ("KASHI", "JIAMUSI", "DSS-43")
BRAKING_M, GM_M3_S2, RADIUS_M = 15e3, 4.9028e12, 1737.4e3


def thrust_m_s2(after_s, length_s, height_m=SITE[2]):
    """Return the radial and transverse thrust from periselene to rest at a height, shape (n, 3)."""
    s = after_s / length_s
    drop_m = BRAKING_M - height_m
    r = RADIUS_M + height_m + drop_m * (1.0 - 10.0 * s**3 + 15.0 * s**4 - 6.0 * s**5)
    rate = drop_m * (-30.0 * s**2 + 60.0 * s**3 - 30.0 * s**4) / length_s
    bend = drop_m * (-60.0 * s + 180.0 * s**2 - 120.0 * s**3) / length_s**2
    begin, upright = np.sqrt(GM_M3_S2 / (RADIUS_M + BRAKING_M) ** 3) * 1.006, 11.0 / 12.0
    turning = np.where(s < upright, begin * (1.0 - s / upright), 0.0)
    slowing = np.where(s < upright, -begin / upright / length_s, 0.0)
    radial = bend - r * turning**2 + GM_M3_S2 / r**2
    return np.stack([radial, r * slowing + 2.0 * rate * turning, np.zeros_like(s)], axis=-1)


@dataclass(frozen=True)
class Descent:
    """Random errors of a descent, its tracking and its fit."""

    seed: int = 0
    spread: float = 0.005  # of the true throttle, and of the attitude in rad, by segment
    length_s: float = 720.0
    planned_s: float = 60.0
    true_s: float = 20.0
    segment_s: float = 10.0
    sigma_m_s2: float = 0.05
    before_s: float = 3000.0  # the epoch of the state, before the touchdown
    after_s: float = 60.0
    step_s: float = 10.0
    range_sigma_m: float = 1.0
    doppler_sigma_m_s: float = 3e-4
    degree: int = 8
    site: tuple[float, float, float] = SITE

    def written(self, path: Path, tables: str = "", **changes: object) -> Path:
        """Write the study to a file, with further tables."""
        path.write_text(f"{replace(self, **changes).text()}\n{tables}\n")
        return path

    def text(self) -> str:
        """Return the study; its truth has another thrust than the plan, and its a-priori state an error."""
        random = np.random.default_rng(self.seed)
        touchdown = epochs_from_strings(TOUCHDOWN, "TDB")
        planned, true = self._segments(self.planned_s), self._segments(self.true_s)
        throttle, pitch, yaw = random.normal(0.0, self.spread, (3, len(true[1]), 1))
        radial, transverse, _ = true[1].T
        size = np.hypot(radial, transverse)
        turned = np.stack([-transverse * pitch[:, 0], radial * pitch[:, 0], size * yaw[:, 0]], axis=-1)
        true = (true[0], true[1] * (1.0 + throttle) + turned)
        epoch = touchdown.shifted(-self.before_s)
        state = self._true_state(touchdown, true) + random.normal(0.0, 1.0, 6) * np.repeat([100.0, 0.1], 3)
        day = datetime.fromisoformat(TOUCHDOWN) - timedelta(seconds=TDB_LESS_UTC_S)
        first, last = (day + timedelta(seconds=s) for s in (120.0 - self.before_s, self.after_s))
        longitude, latitude, height = self.site
        sessions = "\n".join(
            f"[simulation.sessions.{kind}_{links}]\nkind = {kind!r}\nlinks = {links!r}\nstations = {list(stations)}\n"
            f"start = {first:%Y-%m-%dT%H:%M:%S}\nstop = {last:%Y-%m-%dT%H:%M:%S}\nstep_s = {self.step_s}\n"
            f"sigma_m = {sigma_m}\nwavelength_um = 36000.0\n{count}"
            for kind, sigma_m, count in (
                ("range", self.range_sigma_m, ""),
                ("doppler", self.doppler_sigma_m_s * self.step_s, f"count_s = {self.step_s}"),
            )
            for links, stations in (("two_way", STATIONS[:1]), ("three_way", STATIONS))
        )
        return f"""
[target]
name = "lander"
dynamics = "moon"
epoch = "{utc_strings(epoch, 3)[0]}"
position_m = {state[:3].tolist()}
velocity_m_s = {state[3:].tolist()}
[target.landing]
epoch = "{TOUCHDOWN}"
longitude_deg = {longitude}
latitude_deg = {latitude}
height_m = {height}
[forces]
degree = {self.degree}
gravity_errors = 0
accelerations = [{self._tables("plan", planned, f"every_s = {self.segment_s}, sigma_m_s2 = {self.sigma_m_s2}, ")}
]
[observations]
files = ["tracking.csv"]
[consider]
defaults = false
[simulation.forces]
accelerations = [{self._tables("true", true, "")}
]
{sessions}
[simulation.noise.range]
white_m = {self.range_sigma_m}
[simulation.noise.doppler]
white_m = {self.doppler_sigma_m_s * self.step_s}
"""

    def _segments(self, step_s: float) -> tuple[np.ndarray, np.ndarray]:
        starts_s = np.arange(0.0, self.length_s, step_s)
        return starts_s - self.length_s, thrust_m_s2(starts_s + 0.5 * step_s, self.length_s, self.site[2])

    @staticmethod
    def _date(after_s: float) -> str:
        return str(utc_strings(epochs_from_strings(TOUCHDOWN, "TDB").shifted(after_s), 3)[0])

    def _tables(self, name: str, segments: tuple[np.ndarray, np.ndarray], keys: str) -> str:
        starts_s, thrust = segments
        step_s = self.length_s / len(starts_s)
        return "".join(
            f'\n  {{ name = "{name}_{k + 1}", '
            f'start = "{self._date(start_s)}", stop = "{self._date(start_s + step_s)}", '
            f"{keys}constant_m_s2 = {vector.tolist()} }},"
            for k, (start_s, vector) in enumerate(zip(starts_s, thrust, strict=True))
        )

    def _true_state(self, touchdown, segments: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
        """Return the state at the epoch of the northward flight that ends at rest at the site."""
        touchdown_state, normal = at_rest(touchdown, self.site)
        starts_s, thrust = segments
        step_s = self.length_s / len(starts_s)
        burns = tuple(
            Acceleration(
                f"burn{k}",
                constant_m_s2=tuple(vector),
                start=touchdown.shifted(start_s),
                stop=touchdown.shifted(start_s + step_s),
                normal=tuple(normal),
            )
            for k, (start_s, vector) in enumerate(zip(starts_s, thrust, strict=True))
        )
        forces = Forces(GravityField.open("GRGM660PRIM", self.degree), accelerations=burns)
        flight = propagate(
            touchdown,
            touchdown_state[:3],
            touchdown_state[3:],
            forces,
            (-self.before_s, 0.0),
            touchdown=touchdown,
        )
        return np.concatenate(flight.states(touchdown.shifted(-self.before_s)), axis=-1)[0]


def at_rest(epoch, site=SITE) -> tuple[np.ndarray, np.ndarray]:
    """Return the state of a place at an epoch, and the normal of its meridian plane, ICRF."""
    angles_rad, rates_rad_s = LunarOrientation.open().angles(epoch)
    rot, rate = rot_icrf_to_pa(angles_rad)[0], rot_icrf_to_pa_rate(angles_rad, rates_rad_s)[0]
    place_pa_m = LunarPosition.from_selenographic(*site).to_frame("PA_DE421").xyz_m
    state = np.concatenate([rot.T @ place_pa_m, rate.T @ place_pa_m])
    normal = np.cross(state[:3], np.cross(np.cross(state[:3], rot[2]), state[:3]))
    return state, normal / np.linalg.norm(normal)
