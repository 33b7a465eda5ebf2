"""Registries: what the package has, and what other packages add by entry points.

Entry points are loaded when a registry is first looked into, never while radioloc is imported: their modules can import
any part of it, and be imported before it.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cached_property
from importlib.metadata import entry_points
from typing import Any, Protocol, TypeVar

from radioloc.errors import InputError, PluginWarning, RadiolocError


class Named(Protocol):
    """What a registry holds."""

    @property
    def name(self) -> str:
        """Unique name."""
        ...


T = TypeVar("T", bound=Named)
V = TypeVar("V")


class LazyMapping(Mapping[str, V]):
    """A mapping that is made when it is first looked into."""

    def __init__(self, make: Callable[[], dict[str, V]]) -> None:
        self._make = make

    @cached_property
    def _made(self) -> dict[str, V]:
        return self._make()

    def __getitem__(self, name: str) -> V:
        return self._made[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._made)

    def __len__(self) -> int:
        return len(self._made)


class LazyNames(Sequence[str]):
    """A tuple of names that is made when it is first looked into."""

    def __init__(self, make: Callable[[], Iterable[str]]) -> None:
        self._make = make

    @cached_property
    def _made(self) -> tuple[str, ...]:
        return tuple(self._make())

    def __getitem__(self, place: Any) -> Any:
        return self._made[place]

    def __len__(self) -> int:
        return len(self._made)


def registry(group: str, kind: type[T], own: Iterable[T]) -> LazyMapping[T]:
    """Return entries by name, the package's and those of entry points; unusable ones warn and are left out."""

    def made() -> dict[str, T]:
        found = {entry.name: entry for entry in own}
        for point in sorted(entry_points(group=group), key=lambda point: point.name):
            try:
                entry = point.load()
            except Exception as error:  # a package that is broken must not break the others
                problem = f"cannot be loaded ({error})"
            else:
                if not isinstance(entry, kind):
                    problem = f"is a {type(entry).__name__}, not a {kind.__name__}"
                elif entry.name in found:
                    problem = f"has the name {entry.name!r}, which is taken"
                else:
                    found[entry.name] = entry
                    continue
            text = f"{point.value} of the entry points {group} {problem}; it is left out"
            warnings.warn(text, PluginWarning, stacklevel=2)
        return found

    return LazyMapping(made)


@contextmanager
def named_where_it_fails(entry: str, function: str) -> Iterator[None]:
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
