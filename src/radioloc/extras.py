"""Packages that only some uses need: imported when used, and told how to install where absent."""

from __future__ import annotations

import importlib
from types import ModuleType

from radioloc.errors import InputError


def optional(module: str, need: str, extra: str) -> ModuleType:
    """Import a module of an optional package.

    Parameters
    ----------
    module : str
        Its full name.
    need : str
        Who needs what, to stand before the command that installs it.
    extra : str
        The extra of this package that brings it.

    Raises
    ------
    InputError
        It is not installed.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        package = module.partition(".")[0]
        raise InputError(f"{need} pip install {package} (the extra {extra!r} of radioloc)") from error
