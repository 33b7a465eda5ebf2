"""Registries of model parts: those of the package, of entry points of other packages, and those registered at run time.

Entry points are loaded when a registry is first read, never while radioloc is imported: their modules can import any
part of it, and be imported before it.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache, cached_property
from importlib import import_module
from importlib.metadata import entry_points
from typing import Any, Protocol, TypeVar

from radioloc.errors import InputError, PluginWarning, RadiolocError


class Named(Protocol):
    """Entry of a registry."""

    @property
    def name(self) -> str:
        """Unique name."""
        ...


T = TypeVar("T", bound=Named)
V = TypeVar("V")

_REGISTRIES: list[Registry[Any]] = []
_REGISTRY_MODULES = (
    *("media", "measurements.registry", "parameters.registry", "io.formats", "io.exporters"),
    *("targets.target", "study.schema", "results.registry", "report.figure_types"),
)
"""Modules with the registries of :func:`register`, which may not have been imported before."""


@cache
def _installed() -> Any:
    """Entry points of all packages, whose metadata take 7 ms to read."""
    return entry_points()


class Registry(Mapping[str, T]):
    """Entries by name, those of the package first; unusable entry points are left out with a warning."""

    def __init__(self, group: str, kind: type[T], packaged: Iterable[T]) -> None:
        self.group, self.kind, self._packaged = group, kind, tuple(packaged)
        self._registered: set[str] = set()
        _REGISTRIES.append(self)

    @cached_property
    def _entries(self) -> dict[str, T]:
        entries = {entry.name: entry for entry in self._packaged}
        for point in sorted(_installed().select(group=self.group), key=lambda point: point.name):
            try:
                entry = point.load()
            except Exception as error:  # a package that is broken must not break the others
                problem = f"cannot be loaded ({error})"
            else:
                if not isinstance(entry, self.kind):
                    problem = f"is a {type(entry).__name__}, not a {self.kind.__name__}"
                elif entry.name in entries:
                    problem = f"has the name {entry.name!r}, which is taken"
                else:
                    entries[entry.name] = entry
                    continue
            text = f"{point.value} of the entry points {self.group} {problem}; it is left out"
            warnings.warn(text, PluginWarning, stacklevel=2)
        return entries

    def __getitem__(self, name: str) -> T:
        return self._entries[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._entries)

    def __len__(self) -> int:
        return len(self._entries)

    def add(self, entry: T) -> None:
        """Add an entry at run time, in place of one of the same name that was added so."""
        if entry.name in self._entries and entry.name not in self._registered:
            raise InputError(f"register: the name {entry.name!r} is taken in {self.group}; give another name")
        self._registered.add(entry.name)
        self._entries[entry.name] = entry


def register(entry: Named) -> None:
    """Add a medium, parameter, measurement type, target, reader, exporter, ... until Python ends.

    An entry of the same name that was registered earlier is replaced, so that a cell of a notebook can run twice.
    Packages name their entries in entry points instead (``docs/architecture.md``), which also serve several processes.

    Parameters
    ----------
    entry : Medium, ParameterKind, MeasurementType, TargetKind, Reader, Exporter, StudyTable, ResultType or FigureType
        Entry with a ``name``. A medium is active at once; ``[model] off`` switches it off.

    Raises
    ------
    InputError
        The object is of another kind, or its name is taken by the package or an entry point.

    Examples
    --------
    >>> import radioloc
    >>> from radioloc.media import LegDelay
    >>> class Radome:
    ...     name, description, limits_rad = "radome", "4 mm of delay in a radome", ()
    ...     def prepare(self, end):
    ...         return None
    ...     def delay(self, leg, prepared):
    ...         return LegDelay(0.004 * leg.end.radio)
    >>> radioloc.register(Radome())  # doctest: +SKIP
    """
    for module in _REGISTRY_MODULES:
        import_module(f"radioloc.{module}")
    for registry in _REGISTRIES:
        if isinstance(entry, registry.kind):
            registry.add(entry)
            return
    kinds = ", ".join(registry.kind.__name__ for registry in _REGISTRIES)
    raise InputError(
        f"register: expected a {kinds} with all its attributes, got {type(entry).__name__}; "
        "docs/architecture.md lists them"
    )


def registered_names() -> list[str]:
    """Return the names of all entries that were added at run time."""
    return [name for registry in _REGISTRIES for name in registry if name in registry._registered]


class DerivedMapping(Mapping[str, V]):
    """Mapping that follows from registries, made anew at each use."""

    def __init__(self, make: Callable[[], dict[str, V]]) -> None:
        self._make = make

    def __getitem__(self, name: str) -> V:
        return self._make()[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._make())

    def __len__(self) -> int:
        return len(self._make())


class DerivedNames(Sequence[str]):
    """Names that follow from registries, made anew at each use."""

    def __init__(self, make: Callable[[], Iterable[str]]) -> None:
        self._make = make

    def __getitem__(self, place: Any) -> Any:
        return tuple(self._make())[place]

    def __iter__(self) -> Iterator[str]:
        return iter(self._make())

    def __contains__(self, name: object) -> bool:
        return name in tuple(self._make())

    def __len__(self) -> int:
        return len(tuple(self._make()))


@contextmanager
def entry_errors(entry: str, function: str) -> Iterator[None]:
    """Turn an unexpected exception of an entry, as of another package, into one line that names both."""
    try:
        yield
    except (RadiolocError, OSError, MemoryError):
        raise
    except Exception as error:
        raise InputError(
            f"the {entry} cannot be used: {function} fails with {type(error).__name__}: {error}; "
            "fix the package that provides it, or leave it out"
        ) from error
