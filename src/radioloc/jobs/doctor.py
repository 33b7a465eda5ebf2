"""Check of an installation: data of the models, their spans, and missing packages."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from datetime import UTC, date, datetime
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path
from typing import Any

import radioloc
from radioloc.compiled import numba
from radioloc.earth.eop import EopTable
from radioloc.kernels.files import added, registered
from radioloc.results.cards import Card, Field
from radioloc.results.result import Result
from radioloc.study.record import versions
from radioloc.time.scales import last_leap_second

_MAX_EOP_AGE_DAYS = 60
_UPDATE = "pip install --upgrade astropy-iers-data"


@dataclass(frozen=True, slots=True)
class Finding:
    """Result of one check."""

    about: str  # subject of the check
    text: str  # state, and the remedy if something is wrong
    sound: bool = True


@dataclass(frozen=True, slots=True)
class Diagnosis(Result):
    """Findings of :func:`doctor`; ``str()`` is a card."""

    findings: tuple[Finding, ...]

    @property
    def is_usable(self) -> bool:
        """True if all findings are sound."""
        return all(finding.sound for finding in self.findings)

    def to_dict(self) -> dict[str, Any]:
        """Return the status and all findings in types of JSON."""
        return {"sound": self.is_usable, "findings": [asdict(finding) for finding in self.findings]}

    def card(self) -> Card:
        """Return a card with the problems first, then the findings by subject."""
        wrong = [f"{finding.about}: {finding.text}" for finding in self.findings if not finding.sound]
        labels = dict.fromkeys(finding.about for finding in self.findings)
        return Card(
            [
                Field("status", ["sound"] if self.is_usable else [f"NOT SOUND: {text}" for text in wrong]),
                *(
                    Field(label, [finding.text for finding in self.findings if finding.about == label])
                    for label in labels
                ),
            ]
        )


def doctor(today: date | None = None) -> Diagnosis:
    """Check kernels, Earth orientation, leap seconds, the compiler's cache, versions and optional packages."""
    today = today or datetime.now(UTC).date()
    return Diagnosis((*_kernels(), *_earth(today), *_cache(), *_packages()))


def _kernels() -> Iterator[Finding]:
    for kernel in (*registered(), *added()):
        span = f"{kernel.ephemeris} {kernel.kind}, {kernel.start_tdb} to {kernel.end_tdb}"
        problem = kernel.problem()
        yield Finding("kernels", problem or f"{kernel.name}: {span}", not problem)


def _earth(today: date) -> Iterator[Finding]:
    table = EopTable.packaged()
    measured = table.last_measured_date
    age = (today - date.fromisoformat(measured)).days if measured else None
    text = f"Earth orientation measured to {measured}, predicted to {table.last_date}"
    if age is None or age > _MAX_EOP_AGE_DAYS:
        # Sound for older data: extrapolation is never silent.
        text += f"; for data after that, {_UPDATE}"
    yield Finding("Earth", text)
    yield Finding("Earth", f"leap seconds: the last known one is before {last_leap_second()}")


def _cache() -> Iterator[Finding]:
    folder = Path(getattr(numba.config, "CACHE_DIR", "") or Path(radioloc.__file__).parent)
    if getattr(numba.config, "DISABLE_JIT", 0):  # numba sets its attributes as it runs
        yield Finding(
            "compiler", "switched off by NUMBA_DISABLE_JIT: results are the same, some hundred times slower"
        )
    elif os.access(folder, os.W_OK):
        yield Finding("compiler", f"machine code is kept in {folder}")
    else:
        yield Finding(
            "compiler",
            f"{folder} cannot be written to; set NUMBA_CACHE_DIR to a folder that can, or each start compiles again",
        )


def _packages() -> Iterator[Finding]:
    yield Finding("versions", ", ".join(f"{name} {number}" for name, number in versions().items()))
    for extra, names in _extras().items():
        missing = [name for name in names if _version(name) is None]
        present = ", ".join(f"{name} {_version(name)}" for name in names if name not in missing)
        install = f"not installed: {', '.join(missing)}; pip install '.[{extra}]'" if missing else ""
        yield Finding("extras", f"{extra}: {'; '.join(filter(None, (present, install)))}")


def _extras() -> dict[str, list[str]]:
    """Return the packages of each extra for users."""
    packages: dict[str, list[str]] = {}
    for requirement in requires("radioloc") or ():
        package, _, condition = requirement.partition(";")
        extra = condition.partition("extra ==")[2].strip().strip("'\"")
        if extra and extra not in ("dev", "bench"):
            packages.setdefault(extra, []).append(package.split(">")[0].split("<")[0].strip())
    return packages


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None
