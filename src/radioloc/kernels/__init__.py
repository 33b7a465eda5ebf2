"""Find, verify and open SPICE kernels: SPK (positions) and binary PCK (orientation of the Moon).

The kernels that ship are checked against their registered SHA-256 whenever they are opened; any other kernel
is opened after structural checks, with its SHA-256 kept for provenance. What comes out is in the file's own
units (km, rad, TDB seconds since J2000); :mod:`radioloc.ephemeris` turns it into SI.
"""

from radioloc.kernels.files import Kernel, KernelFile, Segment, find_kernel, registered

__all__ = ["Kernel", "KernelFile", "Segment", "find_kernel", "registered"]
