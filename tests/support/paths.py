"""Folders of the project that tests read."""

import os
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
EXAMPLES, DATA = ROOT / "examples", ROOT / "tests" / "data"
ISDS = DATA / "isd"
LARGE_DATA = Path(os.environ.get("RADIOLOC_LARGE_DATA", ROOT.parent / "shared" / "data"))
"""Public data that do not ship with the project; tests that need them are skipped without."""
