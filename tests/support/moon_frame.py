"""Principal axes of DE421 in a frames kernel for SPICE."""

from contextlib import contextmanager

import spiceypy

from radioloc.kernels import find_kernel

PA_FRAME = """KPL/FK
\\begindata
FRAME_MOON_PA_DE421   = 31006
FRAME_31006_NAME      = 'MOON_PA_DE421'
FRAME_31006_CLASS     = 2
FRAME_31006_CLASS_ID  = 31006
FRAME_31006_CENTER    = 301
\\begintext
"""


@contextmanager
def spice_moon(folder):
    """Load DE421, its libration and the principal axes in SPICE."""
    (folder / "moon_pa.tf").write_text(PA_FRAME)
    files = find_kernel("DE421", "SPK"), find_kernel("DE421", "PCK"), folder / "moon_pa.tf"
    with spiceypy.KernelPool(list(map(str, files))):
        yield
