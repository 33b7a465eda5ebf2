"""How frames, map and elevation model of this example were made: a descent over simulated ground, truth known.

    python examples/images/simulate.py

The map says that everything is 30 m east and 20 m south of where it is, as one that is tied to the Moon to 25 m might.
"""

import sys
from pathlib import Path

from radioloc.imaging import Camera
from radioloc.imaging.shading import sun_direction
from radioloc.lunar import TangentPlane

FOLDER = Path(__file__).parent
sys.path.append(str(FOLDER.parents[1] / "tests" / "support"))  # where the simulated ground is
from procedural_descents import Descent  # noqa: E402
from procedural_ground import Ground  # noqa: E402

SIZE_PX = 320
SHIFT_M = (30.0, -20.0)

GROUND = Ground(TangentPlane(-51.9162, 43.0584), seed=5, level_m=-2550.0)
DESCENT = Descent(
    GROUND,
    # The Chang'e-3 descent camera with pixels put together: 8.3 mm, 1024 pixels of 6.7 micrometres.
    Camera.of_pinhole(8.3, 6.7 * 1024 / SIZE_PX, [0.5 * (SIZE_PX - 1)] * 2, [-0.05]),
    (SIZE_PX, SIZE_PX),
    frames=16,
    altitudes_m=(6000.0, 4.0),
    seed=5,
)

if __name__ == "__main__":
    for path in DESCENT.write(FOLDER):
        print(path)
    GROUND.write_map(FOLDER / "map.tif", 8.0, 9000.0, sun_direction(70.0, 45.0), SHIFT_M, noise=1.0)
    GROUND.write_heights(FOLDER / "dem.tif", 60.0, 10000.0)
