"""Progress bars where somebody looks: on a terminal, and in a notebook."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterable
from typing import Any


def progress_bar(of: Iterable[Any] | None = None, *, wanted: bool, **options: Any) -> Any:
    """Make a bar of tqdm with its options; it is hidden unless it is wanted and standard error is looked at."""
    with warnings.catch_warnings():
        # A notebook without ipywidgets has a bar of characters.
        warnings.filterwarnings("ignore", "IProgress not found")
        from tqdm.auto import tqdm
    return tqdm(of, disable=not (wanted and _is_looked_at()), **options)


def _is_looked_at() -> bool:
    stream = sys.stderr
    return bool(stream) and (stream.isatty() or type(stream).__module__ == "ipykernel.iostream")
