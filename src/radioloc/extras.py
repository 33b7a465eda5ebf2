"""Packages that only some uses need: imported when used, and told how to install where absent."""

from __future__ import annotations

import importlib
from types import ModuleType

from radioloc.errors import InputError


def optional(module: str, need: str, extra: str) -> ModuleType:
    """Import a module of an optional package; `need` says who needs what, before the command that installs it."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise InputError(f"{need} pip install 'radioloc[{extra}]'") from error
