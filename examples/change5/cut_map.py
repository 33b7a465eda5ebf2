"""Cut the landing site out of LDEM_4, the lunar elevation map of LRO's laser altimeter at four cells a degree.

    python cut_map.py LDEM_4.LBL        write ldem_4_landing_site.tif

LDEM_4.LBL and LDEM_4.IMG are product LDEM_4 of NASA's Planetary Data System, LRO-L-LOLA-4-GDR-V1.0, and in the public
domain. Heights are kept as they are: 16-bit integers of half a metre, above 1737.4 km.
"""

import math
import sys
from pathlib import Path

import rasterio
from rasterio.transform import Affine
from rasterio.windows import Window

FILE = Path(__file__).resolve().parent / "ldem_4_landing_site.tif"
WEST_DEG, NORTH_DEG, SIZE = -56, 47, 32  # 8 degrees by 8
DEGREE_M = math.radians(1737400.0)


def main(label):
    with rasterio.open(label) as whole:
        # The map goes from 0 to 360 degrees east.
        window = Window(4 * (WEST_DEG % 360), 4 * (90 - NORTH_DEG), SIZE, SIZE)
        # The label rounds the size of a cell; it is a quarter of a degree, counted from 180 degrees east.
        west_m, north_m = DEGREE_M * (WEST_DEG % 360 - 180), DEGREE_M * NORTH_DEG
        corner = Affine(DEGREE_M / 4, 0.0, west_m, 0.0, -DEGREE_M / 4, north_m)
        profile = {
            "driver": "GTiff",
            "width": SIZE,
            "height": SIZE,
            "count": 1,
            "dtype": "int16",
            "crs": whole.crs,
            "transform": corner,
            "compress": "deflate",
        }
        with rasterio.open(FILE, "w", **profile) as part:
            part.write(whole.read(1, window=window), 1)
            part.units, part.scales, part.offsets = ("m",), (0.5,), (0.0,)
            part.update_tags(SOURCE="NASA PDS, LRO-L-LOLA-4-GDR-V1.0, LDEM_4", TARGET_NAME="MOON")


if __name__ == "__main__":
    main(sys.argv[1])
