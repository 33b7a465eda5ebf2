"""Scene of 25 minutes with targets of every kind, tracked by three stations, and studies of some of them."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from arc_cases import observed_at
from descent import Descent

import radioloc
from radioloc import LunarPosition, Observations, Study
from radioloc.dynamics import Forces, GravityField
from radioloc.ephemeris import Trajectory
from radioloc.io.spice_kernels import write_orbit_spk
from radioloc.measurements import ExactPredictor, Link, PhysicalModel
from radioloc.measurements.observations import DOPPLER, RANGE
from radioloc.study import EstimateChoice, ObservationChoice
from radioloc.study.orbit_choice import OrbitChoice
from radioloc.study.orbiter import Orbiter

FLIGHT = Descent(before_s=1500.0, step_s=30.0, segment_s=60.0, planned_s=60.0, true_s=60.0, degree=4)
LANDER = LunarPosition.from_selenographic(-51.9, 43.05, -2500.0, "ME_DE421")
ROVER = LunarPosition.from_selenographic(-20.0, 10.0, -1500.0, "ME_DE421")
STATE = np.array([-575739.0, -463249.0, 1631639.0, -567.864, -1434.223, -600.209])
OFF = np.array([100.0, -80.0, 60.0, 0.1, -0.08, 0.05])
PLACE = LunarPosition.from_selenographic(*FLIGHT.site, "ME_DE421")
BODY = -85
SECONDS = np.arange(150.0, 1800.0, 60.0)
STATIONS = ("KASHI", "JIAMUSI", "DSS-43")
SIGMA_M = {RANGE: 1.0, DOPPLER: 0.01}


@dataclass(frozen=True)
class Scene:
    """A-priori targets by name, their truth, and observations of all of them."""

    targets: dict
    true: dict  # for scenarios
    observations: Observations

    def study(self, *names, **changes) -> Study:
        """Return the study of some targets, with wide priors of orbits."""
        targets = {name: self.targets[name] for name in names}
        estimate = EstimateChoice(position="geographic" if {*names} - {"known", "craft", "other"} else "none")
        if {*names} & {"craft", "other"}:
            estimate = replace(estimate, orbit=OrbitChoice(state_sigma_m=1e3, state_sigma_m_s=1.0))
        fields = {"targets": targets, "estimate": estimate, "consider_defaults": False} | changes
        return Study(observations=ObservationChoice(targets=names), **fields)


def scene(folder: Path) -> Scene:
    """Return lander, rover, two orbiters, a trajectory in a file, and a descent."""
    study = radioloc.read_study(FLIGHT.written(folder / "descent.toml"))
    forces = Forces(GravityField.open("GRGM660PRIM", degree=4))
    epoch = study.orbiter.epoch
    turned = STATE[[1, 0, 2, 4, 3, 5]]

    def craft(name, state):
        return Orbiter(epoch, tuple(state[:3]), tuple(state[3:]), forces, name, gravity_errors=0)

    flying = {"craft": craft("craft", STATE), "other": craft("other", turned)}
    n, names = len(SECONDS), ("lander", "rover", "craft", "other", "known", "descent")
    cases = [(kind, station, name) for name in names for kind in (RANGE, DOPPLER) for station in STATIONS]
    kind = np.repeat([case[0] for case in cases], n)
    table = observed_at(
        epoch.shifted(np.tile(SECONDS, len(cases))),
        [Link(station, name, station) for _, station, name in cases],
        link=np.repeat(np.arange(len(cases)), n),
        kind=kind,
        sigma_m=np.array([SIGMA_M[k] for k in kind]),
        count_s=np.where(kind == DOPPLER, 60.0, np.nan),
        wavelength_um=3.6e4,
    )
    model = PhysicalModel.build()
    orbits = {name: orbiter.orbit(model, table, ()) for name, orbiter in flying.items()}
    write_orbit_spk(folder / "known.bsp", orbits["craft"].integrate(), body=BODY)
    trajectory = Trajectory.open(folder / "known.bsp", BODY)
    landing = study.simulation.position
    true = {"lander": LANDER, "rover": ROVER, **flying, "known": trajectory, "descent": landing}
    motions = (LANDER, ROVER, *orbits.values(), trajectory, landing.orbit_spanning(model, table.span(), 60.0))
    computed = ExactPredictor(model, table, motions, targets=names).compute()
    targets = {
        "lander": LunarPosition.from_selenographic(-51.88, 43.04, -2450.0, "ME_DE421"),
        "rover": LunarPosition.from_selenographic(-20.02, 10.01, -1450.0, "ME_DE421"),
        "craft": craft("craft", STATE + OFF),
        "other": craft("other", turned - OFF),
        "known": trajectory,
        "descent": study.orbiter,
    }
    noise_m = table.sigma_m * np.random.default_rng(3).normal(size=len(table))
    observed = replace(table, value_m=computed.value_m + noise_m)
    return Scene(targets, true, observed.select(computed.usable))
