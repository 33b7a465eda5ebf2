"""The names under which the points on the Moon go, and the one that is used inside."""

from __future__ import annotations

_ALIASES = {
    "apollo11": ("apollo 11", "ap11", "a11"),
    "apollo14": ("apollo 14", "ap14", "a14"),
    "apollo15": ("apollo 15", "ap15", "a15"),
    "luna17": ("luna 17", "lunokhod1", "lunokhod 1", "l1", "lk1"),
    "nglr1": ("nglr 1", "ngl1", "ngl 1"),
    "luna21": ("luna 21", "lunokhod2", "lunokhod 2", "l2", "lk2"),
}
REFLECTORS = tuple(sorted(_ALIASES))
"""Canonical names of the laser reflectors on the Moon."""

_CANONICAL = {alias: name for name, aliases in _ALIASES.items() for alias in (name, *aliases)}


def canonical_target(name: str) -> str:
    """Name of a point on the Moon as the ILRS writes it: ``apollo11``, ``luna17``, ...

    Parameters
    ----------
    name : str
        Any of the names in use, such as ``"Apollo 15"``, ``"AP15"``, ``"Lunokhod 1"``; case, hyphens
        and underscores do not matter.

    Returns
    -------
    str
        The canonical name; a name that is not known comes back in lower case without blanks at its ends.
    """
    lower = " ".join(name.lower().split())
    return _CANONICAL.get(lower.replace("-", " ").replace("_", " "), lower)
