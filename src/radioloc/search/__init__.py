"""Searches that complete a study: first orbits, transmitters, undocumented manoeuvres."""

from typing import TYPE_CHECKING

from radioloc.lazy import lazy_exports as _lazy_exports

if TYPE_CHECKING:  # imported on first use
    from radioloc.search.study_search import search

__all__ = ["search"]

__getattr__, __dir__ = _lazy_exports(__name__, {"study_search": "search"})
