"""Exterior orientation from SPICE kernels: trajectory of the spacecraft, attitude of the camera."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np

from radioloc import vectors
from radioloc.errors import InputError, KernelError
from radioloc.imaging.orientation import TabulatedOrientation, quaternions_of
from radioloc.kernels.spice_calls import spice_message, spice_path
from radioloc.kernels.spk_types import check_spk
from radioloc.lunar.frames import rot_icrf_to_me
from radioloc.quantities import accepts_quantities
from radioloc.text_files import head_of, require_file
from radioloc.time import Epochs

_KM = 1e3


@accepts_quantities
def orientation_from_spice(
    kernels: Sequence[str | Path],
    *,
    spacecraft: str | int,
    camera_frame: str,
    epoch_tdb_s: float,
    span_s: tuple[float, float],
    step_s: float,
) -> TabulatedOrientation:
    """The orientation of a camera in ME_DE421, as SPICE kernels have it, at even times.

    Parameters
    ----------
    kernels : sequence of path-like
        Trajectory (SPK), attitude (CK) with the spacecraft's clock (SCLK), frames (FK), leap seconds (LSK) if these
        need it. The Moon's own orientation is the library's.
    spacecraft : str or int
        NAIF name or code, such as -85.
    camera_frame : str
        Name of the camera's axes, such as ``"LRO_LROCNACL"``.
    epoch_tdb_s : float
        From which times count, TDB seconds since J2000.
    span_s : tuple of float
        First and last time from the epoch, s.
    step_s : float
        Between nodes, at most.

    Raises
    ------
    KernelError
        A kernel cannot be read, or together they do not have the spacecraft or the camera at a time.
    InputError
        The span or step make no table.

    Notes
    -----
    Geometric: as for LRO's own products there is no light time (0.3 ms at 100 km) and no aberration (1.6 km/s over the
    velocity of light, 0.5 m at 100 km).

    Examples
    --------
    >>> from radioloc.imaging import orientation_from_spice
    >>> orientation_from_spice(
    ...     ["lro.bsp", "lro.bc", "lro.tsc", "lro.tf"], spacecraft=-85, camera_frame="LRO_LROCNACL",
    ...     epoch_tdb_s=302228504.57, span_s=(-0.3, 0.3), step_s=0.01,
    ... )  # doctest: +SKIP
    """
    import spiceypy

    if not (span_s[1] > span_s[0] and 0.0 < step_s <= span_s[1] - span_s[0]):
        raise InputError(f"span_s = {span_s!r} with step_s = {step_s!r} makes no table of two times or more")
    times = np.linspace(*span_s, 1 + int(np.ceil((span_s[1] - span_s[0]) / step_s - 1e-9)))
    epochs = epoch_tdb_s + times
    times = epochs - epoch_tdb_s  # as SPICE is asked, rounded to 0.1 microseconds
    with _loaded(kernels):
        states = np.array([spiceypy.spkezr(str(spacecraft), et, "J2000", "NONE", "MOON")[0] for et in epochs])
        to_j2000 = np.array([spiceypy.pxform(camera_frame, "J2000", et) for et in epochs])
    to_moon = rot_icrf_to_me(Epochs.from_tdb_seconds(np.full(len(times), epoch_tdb_s)).shifted(times))
    positions = vectors.rotated(to_moon, _KM * states[:, :3])
    return TabulatedOrientation(times, positions, times, quaternions_of(to_moon @ to_j2000))


@contextmanager
def _loaded(kernels: Sequence[str | Path]) -> Iterator[None]:
    """Kernels loaded for a while; what SPICE complains of is one line."""
    import spiceypy
    from spiceypy.utils.exceptions import SpiceyError

    paths = [Path(one) for one in kernels]
    for path in paths:
        require_file(path)
        if head_of(path, 8) == b"DAF/SPK ":
            check_spk(path)  # SPICE ends the process at some damages
    try:
        with ExitStack() as stack:
            for path in paths:
                name = stack.enter_context(spice_path(path))
                spiceypy.furnsh(name)
                stack.callback(spiceypy.unload, name)
            yield
    except SpiceyError as error:
        raise KernelError(
            f"SPICE cannot give the camera's orientation from {', '.join(map(str, paths))}: {spice_message(error)}"
        ) from error
