"""The kernels that ship: what they are, where they lie, what their SHA-256 must be."""

from __future__ import annotations

import hashlib
import tomllib
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from radioloc.errors import KernelError

REGISTRY_NAME = "registry.toml"


@dataclass(frozen=True, slots=True)
class RegisteredKernel:
    """One kernel that ships."""

    name: str  # of the file
    kind: str  # SPK (positions) or PCK (orientation)
    ephemeris: str  # that it is cut from, such as DE421
    sha256: str
    size_bytes: int
    start_tdb: str  # dates at whose midnight (TDB) the span begins and ends
    end_tdb: str
    bodies: tuple[int, ...]  # NAIF codes of the bodies (SPK) or frames (PCK)
    source_package: str  # that carries the full kernel it was cut from
    source_file: str
    source_sha256: str


@cache
def kernel_directory() -> Path:
    """Directory of the kernels that ship: inside the installed package, or ``kernels/`` of a source checkout."""
    packaged = Path(__file__).parent / "data"
    checkout = Path(__file__).parents[3] / "kernels"
    for directory in (packaged, checkout):
        if (directory / REGISTRY_NAME).is_file():
            return directory
    raise KernelError(
        f"the kernels that ship with radioloc are not at {packaged} (installed) or {checkout} (source "
        "checkout); install the package again"
    )


@cache
def registered() -> tuple[RegisteredKernel, ...]:
    """Kernels that ship, in the registry's order."""
    table = tomllib.loads((kernel_directory() / REGISTRY_NAME).read_text(encoding="utf-8"))
    return tuple(RegisteredKernel(**{**entry, "bodies": tuple(entry["bodies"])}) for entry in table["kernel"])


def find_kernel(name_or_path: str | Path, kind: str | None = None) -> Path:
    """Path of a kernel: of a file, or of one that ships by its name or its ephemeris' (``"DE421"``, with `kind`)."""
    path = Path(name_or_path)
    if path.is_file():
        return path
    name = str(name_or_path)
    fits = [
        entry
        for entry in registered()
        if name == entry.name or (name.upper() == entry.ephemeris and kind in (None, entry.kind))
    ]
    if len(fits) == 1:
        return kernel_directory() / fits[0].name
    known = ", ".join(f"{entry.name} ({entry.ephemeris} {entry.kind})" for entry in registered())
    if path.is_dir():
        raise KernelError(f"{name} is a directory; give a kernel file in it")
    if fits:
        raise KernelError(f"{name!r} stands for more than one kernel; name the file, one of {known}")
    raise KernelError(
        f"{name!r} is neither a file nor a kernel that ships; give the path of a kernel file, "
        f"or one of {known}"
    )


def sha256_of(path: Path) -> str:
    """SHA-256 of a file, as 64 hexadecimal digits."""
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise KernelError(f"{path} cannot be read: {error.strerror}") from error
