"""Provenance of a result in types that JSON has: settings, files by their SHA-256, versions."""

from __future__ import annotations

import hashlib
import json
import math
import platform
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from enum import Enum
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from radioloc._version import __version__
from radioloc.kernels import find_kernel
from radioloc.kernels.files import sha256_of
from radioloc.study.study import ModelChoice, Study, TerrainPrior

_MAX_LIST_NUMBERS = 100
_WITHOUT_EFFECT = ("catalogue", "name", "path", "reference", "references")
"""Fields of a study without effect on results; the catalogue is recorded as the list of its stations."""
_PACKAGES = ("numpy", "scipy", "numba", "pyerfa", "astropy-iers-data")

_DESCRIPTIVE_FIELDS = ("complex", "country")  # Fields of stations without effect on results


@cache
def versions() -> Mapping[str, str]:
    """Return the versions of radioloc, Python and the packages that compute."""
    # Read once: a lookup takes a millisecond and is not thread-safe.
    return {
        "radioloc": __version__,
        "python": platform.python_version(),
        **{name: version(name) for name in _PACKAGES},
    }


def study_settings(study: Study) -> dict[str, Any]:
    """Return the settings that determine the results of a study, by field; files as name and SHA-256."""
    names = [f.name for f in fields(study) if f.name not in _WITHOUT_EFFECT]
    return {name: plain(getattr(study, name)) for name in names} | {"stations": plain(list(study.catalogue))}


def study_origin(study: Study) -> dict[str, Any]:
    """Return the file of a study, its input files, and the SHA-256 of each table of settings."""
    assert study.path is not None
    settings = study_settings(study)
    return {
        "file": str(study.path.resolve()),
        "sha256": sha256_of(study.path),
        "hours": study.observations.hours,
        "inputs": list(_files(settings)),
        "settings": {name: _sha256(json.dumps(table).encode()) for name, table in settings.items()},
    }


def _files(value: Any) -> Iterator[dict[str, str]]:
    if isinstance(value, Mapping):
        if set(value) == {"file", "sha256"}:
            yield dict(value)
        for item in value.values():
            yield from _files(item)
    elif isinstance(value, list):
        for item in value:
            yield from _files(item)


def plain(value: Any) -> Any:
    """Convert to numbers, texts, lists and tables; files and long lists to their SHA-256."""
    for kind, convert in _CONVERTERS.items():
        if isinstance(value, kind):
            return convert(value)
    if is_dataclass(value):
        return {
            f.name: plain(getattr(value, f.name)) for f in fields(value) if f.name not in _DESCRIPTIVE_FIELDS
        }
    if callable(value):
        return f"{value.__module__}.{value.__qualname__}"
    return str(value) if isinstance(value, float) and not math.isfinite(value) else value


def _terrain(prior: TerrainPrior) -> dict[str, Any]:
    maps = [{"file": file.path.name, "sha256": file.sha256} for file in prior.terrain.metadata.files]
    return {"maps": maps, "interpolation": prior.terrain.interpolation, "sigma_m": prior.sigma_m}


def _model(choice: ModelChoice) -> dict[str, Any]:
    kernels = {"ephemeris": "SPK", "libration": "PCK"}
    files = {name: find_kernel(getattr(choice, name), kind) for name, kind in kernels.items()}
    return {f.name: plain(files.get(f.name, getattr(choice, f.name))) for f in fields(choice)}


def _sequence(values: Sequence[Any]) -> Any:
    items = [plain(item) for item in values]
    numbers = len(items) >= _MAX_LIST_NUMBERS and all(isinstance(item, int | float) for item in items)
    return _sha256(json.dumps(items).encode()) if numbers else items


_CONVERTERS: dict[Any, Callable[[Any], Any]] = {
    TerrainPrior: _terrain,
    ModelChoice: _model,
    Path: lambda path: {"file": path.name, "sha256": sha256_of(path) if path.is_file() else None},
    Enum: lambda member: plain(member.value),
    np.ndarray: lambda array: plain(array.tolist()),
    Mapping: lambda mapping: {str(key): plain(item) for key, item in mapping.items()},
    set | frozenset: lambda items: sorted(map(plain, items)),
    list | tuple: _sequence,
}
"""Conversions of values by their types."""


def _sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()
