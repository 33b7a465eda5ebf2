"""Text columns with few distinct values, as a code for each row; distinct rows of arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

USED = "used"
"""Status of an observation in the fit; every other status is the reason of its rejection."""


@dataclass(frozen=True, slots=True, eq=False)
class Labels:
    """Column of texts with four bytes a row; indexing returns an array of str."""

    codes: NDArray[np.int32]  #: (n,), index into `texts`
    texts: tuple[str, ...]  #: distinct texts

    @classmethod
    def from_texts(cls, values: Labels | ArrayLike | Sequence[str]) -> Labels:
        """Return the labels of a column of texts; labels are returned unchanged."""
        if isinstance(values, Labels):
            return values
        array = np.asarray(values, dtype=np.str_)
        texts, codes = np.unique(array, return_inverse=True)
        return cls(codes.astype(np.int32).reshape(array.shape), tuple(texts.tolist()))

    @classmethod
    def coded(cls, texts: Sequence[str], codes: NDArray[Any]) -> Labels:
        """Return labels from indices into texts, which may repeat."""
        index: dict[str, int] = {}
        recode = np.array([index.setdefault(text, len(index)) for text in texts], dtype=np.int32)
        if len(index) == len(texts) and codes.dtype == np.int32:
            return cls(codes, tuple(index))
        return cls(recode[codes] if len(recode) else np.zeros(0, dtype=np.int32), tuple(index))

    def __len__(self) -> int:
        return len(self.codes)

    def __getitem__(self, rows: Any) -> Any:
        """Return the text of a row, or the texts of a slice, a mask or indices of rows."""
        return np.array(self.texts or ("",), dtype=np.str_)[self.codes[rows]]

    def select(self, rows: Any) -> Labels:
        """Return the labels of some rows."""
        return Labels(self.codes[rows], self.texts)

    def are(self, text: str) -> NDArray[np.bool_]:
        """Return the mask of rows with a text, shape (n,)."""
        if text not in self.texts:
            return np.zeros(len(self), dtype=bool)
        return np.asarray(self.codes == self.texts.index(text))

    def present(self) -> tuple[str, ...]:
        """Return the texts of at least one row, in alphabetical order."""
        counts = np.bincount(self.codes, minlength=len(self.texts))
        return tuple(sorted(text for text, count in zip(self.texts, counts, strict=False) if count))


def changed(*arrays: NDArray[Any]) -> NDArray[np.bool_]:
    """Return the mask of rows of arrays (n, ...) that differ from the preceding row, and of the first, shape (n,)."""
    new = np.ones(len(arrays[0]), dtype=bool)
    new[1:] = False
    for array in arrays:
        new[1:] |= (array[1:] != array[:-1]).any(axis=tuple(range(1, array.ndim)))
    return new


def distinct(rows: NDArray[Any]) -> tuple[NDArray[Any], NDArray[np.intp]]:
    """Return the distinct rows of an array (n, k), sorted, and the index of each row among them, (n,)."""
    new = changed(rows)  # most rows equal the preceding one
    values, index = np.unique(rows[new], axis=0, return_inverse=True)
    return values, index.ravel()[np.cumsum(new) - 1]
