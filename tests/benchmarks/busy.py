"""Times of a busy machine are no reason to fail."""

from __future__ import annotations

import os

import pytest


def skip_if_busy(most_load: float, what: str) -> None:
    """Skip the test if the load of the last minute is larger; `what` says which figures then say nothing."""
    load = os.getloadavg()[0]
    if load > most_load:
        pytest.skip(f"the machine is busy (load {load:.1f}): {what}")
