"""Imports on first use: exports of packages, and optional packages with the command that installs them."""

import sys
from collections.abc import Callable, Mapping
from importlib import import_module
from types import ModuleType
from typing import Any

from radioloc.errors import InputError


def lazy_exports(
    package: str, names_by_module: Mapping[str, str], packages: str = ""
) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """Return ``__getattr__`` and ``__dir__`` of a package from names, split by spaces, of its modules and packages."""
    modules = {name: module for module, names in names_by_module.items() for name in names.split()}

    def get(name: str) -> Any:
        if name in modules:
            value = getattr(import_module(f"{package}.{modules[name]}"), name)
            setattr(sys.modules[package], name, value)
            return value
        try:
            return import_module(f"{package}.{name}")
        except ModuleNotFoundError as error:
            if error.name != f"{package}.{name}":
                raise
            raise AttributeError(f"module {package!r} has no attribute {name!r}") from None

    return get, lambda: sorted([*sys.modules[package].__all__, *packages.split()])


def optional(module: str, need: str, extra: str) -> ModuleType:
    """Import a module of an optional package; `need` begins the message, before the command that installs it."""
    try:
        return import_module(module)
    except ImportError as error:
        raise InputError(f"{need} pip install 'radioloc[{extra}]'") from error
