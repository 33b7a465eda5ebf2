"""LOLA's map of 4 cells per degree from cells in tests/data, as an image with its label."""

from pathlib import Path

import numpy as np

FOLDER = Path(__file__).resolve().parents[1] / "data" / "dem"
SHAPE = (720, 1440)


def write_ldem_4(folder: Path) -> Path:
    """Write LDEM_4.IMG and its label; missing cells repeat the nearest of every seventh cell above and left."""
    cells = np.load(FOLDER / "ldem_4_cells.npz")
    available = np.unpackbits(cells["known"], count=SHAPE[0] * SHAPE[1]).astype(bool).reshape(SHAPE)
    numbers = np.zeros(SHAPE, dtype="<i2")
    numbers[available] = cells["number"]
    rows, columns = (np.arange(n) // 7 * 7 for n in SHAPE)
    np.where(available, numbers, numbers[np.ix_(rows, columns)]).astype("<i2").tofile(folder / "LDEM_4.IMG")
    label = folder / "LDEM_4.LBL"
    label.write_bytes((FOLDER / "LDEM_4.LBL").read_bytes())
    return label
