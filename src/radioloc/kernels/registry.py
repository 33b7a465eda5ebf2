"""The kernels that ship or were added: what they are, where they lie, what their SHA-256 must be."""

from __future__ import annotations

import hashlib
import os
import tomllib
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from radioloc.errors import KernelError

REGISTRY_NAME = "registry.toml"


@dataclass(frozen=True, slots=True)
class RegisteredKernel:
    """One kernel that ships or was added."""

    name: str  # of the file
    kind: str  # SPK (positions) or PCK (orientation)
    ephemeris: str  # that it is cut from, such as DE421
    sha256: str
    size_bytes: int
    start_tdb: str  # dates at whose midnight (TDB) the span begins and ends
    end_tdb: str
    bodies: tuple[int, ...]  # NAIF codes of the bodies (SPK) or frames (PCK)
    source_package: str = ""  # that carries the full kernel it was cut from
    source_file: str = ""
    source_sha256: str = ""
    folder: Path = Path()

    @property
    def path(self) -> Path:
        """The file."""
        return self.folder / self.name

    def problem(self) -> str:
        """What is wrong with the file, and what to do; empty where it is what it was."""
        was, again = "added", "add it again by radioloc kernels add"
        if self.source_package:
            was, again = "shipped", "install radioloc again"
        if not self.path.is_file():
            return f"{self.path} is missing; {again}"
        if sha256_of(self.path) != self.sha256:
            return f"{self.path} is not the file that was {was}; {again}"
        return ""


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
    return _entries(kernel_directory())


def user_directory() -> Path:
    """Directory of the kernels that were added: ``RADIOLOC_KERNELS``, or else ``~/.radioloc/kernels``."""
    return Path(os.environ.get("RADIOLOC_KERNELS") or Path.home() / ".radioloc" / "kernels")


def added() -> tuple[RegisteredKernel, ...]:
    """Kernels that were added by :func:`radioloc.kernels.add_kernel`, in their order.

    Examples
    --------
    >>> import os, shutil, tempfile
    >>> from radioloc.kernels import add_kernel, added, find_kernel
    >>> os.environ["RADIOLOC_KERNELS"] = tempfile.mkdtemp()
    >>> mine = shutil.copy(find_kernel("DE440", "PCK"), os.path.join(tempfile.mkdtemp(), "mine.bpc"))
    >>> _ = add_kernel(mine)
    >>> [kernel.name for kernel in added()]
    ['mine.bpc']
    """
    folder = user_directory()
    return _entries(folder) if (folder / REGISTRY_NAME).is_file() else ()


def _entries(folder: Path) -> tuple[RegisteredKernel, ...]:
    path = folder / REGISTRY_NAME
    try:
        entries = tomllib.loads(path.read_text(encoding="utf-8"))["kernel"]
        return tuple(
            RegisteredKernel(**entry | {"bodies": tuple(entry["bodies"]), "folder": folder})
            for entry in entries
        )
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise KernelError(f"{path} is damaged ({error}); remove it and add its kernels again") from error


def find_kernel(name_or_path: str | Path, kind: str | None = None) -> Path:
    """Path of a kernel: of a file, or of one that ships or was added, by its name or its ephemeris' (``"DE421"``).

    With `kind` an ephemeris names one file. Kernels that ship come before those that were added.

    Examples
    --------
    >>> from radioloc.kernels import find_kernel
    >>> find_kernel("DE421", "PCK").name
    'moon_pa_de421_1969_2050.bpc'
    """
    path = Path(name_or_path)
    if path.is_file():
        return path
    name = str(name_or_path)
    fits: list[RegisteredKernel] = []
    for entries in (registered(), added()):
        fits = fits or [
            entry
            for entry in entries
            if name == entry.name or (name.upper() == entry.ephemeris and kind in (None, entry.kind))
        ]
    if len(fits) == 1:
        return fits[0].path
    known = ", ".join(f"{entry.name} ({entry.ephemeris} {entry.kind})" for entry in (*registered(), *added()))
    if path.is_dir():
        raise KernelError(f"{name} is a directory; give a kernel file in it")
    if fits:
        raise KernelError(f"{name!r} stands for more than one kernel; name the file, one of {known}")
    raise KernelError(
        f"{name!r} is neither a file nor a kernel that ships or was added; give the path of a kernel file, "
        f"or one of {known}"
    )


def sha256_of(path: Path) -> str:
    """SHA-256 of a file, as 64 hexadecimal digits.

    Examples
    --------
    >>> from radioloc.kernels import find_kernel, open_spk, sha256_of
    >>> sha256_of(find_kernel("DE421", "SPK")) == open_spk("DE421").file.sha256
    True
    """
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise KernelError(f"{path} cannot be read: {error.strerror}") from error
