"""Texts of many rows, of which few differ: a small number for each row, and each text once; and runs of equal rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

USED = "used"
"""Status of an observation that takes part in the fit; every other status is the reason why it does not."""


@dataclass(frozen=True, slots=True, eq=False)
class Labels:
    """A column of texts in four bytes a row; an index gives an array of str.

    Parameters
    ----------
    codes : ndarray of int32, shape (n,)
        Index into `texts`.
    texts : tuple of str
        Each once.
    """

    codes: NDArray[np.int32]
    texts: tuple[str, ...]

    @classmethod
    def of(cls, values: Labels | ArrayLike | Sequence[str]) -> Labels:
        """Labels of a column of texts, or as they are."""
        if isinstance(values, Labels):
            return values
        array = np.asarray(values, dtype=np.str_)
        texts, which = np.unique(array, return_inverse=True)
        return cls(which.astype(np.int32).reshape(array.shape), tuple(texts.tolist()))

    @classmethod
    def coded(cls, texts: Sequence[str], codes: NDArray[Any]) -> Labels:
        """Labels of an index into texts, of which several may be the same."""
        place: dict[str, int] = {}
        recode = np.array([place.setdefault(text, len(place)) for text in texts], dtype=np.int32)
        return cls(recode[codes] if len(recode) else np.zeros(0, dtype=np.int32), tuple(place))

    def __len__(self) -> int:
        return len(self.codes)

    def __getitem__(self, rows: Any) -> Any:
        """Text of a row, or array of the texts of a slice, a mask or indices of rows."""
        return np.array(self.texts or ("",), dtype=np.str_)[self.codes[rows]]

    def select(self, rows: Any) -> Labels:
        """Some rows."""
        return Labels(self.codes[rows], self.texts)

    def are(self, text: str) -> NDArray[np.bool_]:
        """Which rows have a text, shape (n,)."""
        if text not in self.texts:
            return np.zeros(len(self), dtype=bool)
        return np.asarray(self.codes == self.texts.index(text))

    def present(self) -> tuple[str, ...]:
        """Texts that some row has, in alphabetic order."""
        counts = np.bincount(self.codes, minlength=len(self.texts))
        return tuple(sorted(text for text, count in zip(self.texts, counts, strict=False) if count))


def changed(*arrays: NDArray[Any]) -> NDArray[np.bool_]:
    """Which rows of arrays (n, ...) differ from the row before, shape (n,); the first counts as one."""
    new = np.ones(len(arrays[0]), dtype=bool)
    new[1:] = False
    for one in arrays:
        new[1:] |= (one[1:] != one[:-1]).any(axis=tuple(range(1, one.ndim)))
    return new


def distinct(rows: NDArray[Any]) -> tuple[NDArray[Any], NDArray[np.intp]]:
    """Rows that occur in an array (n, k), in order, and which of them each is, (n,); most are as the one before."""
    new = changed(rows)
    found, which = np.unique(rows[new], axis=0, return_inverse=True)
    return found, which.ravel()[np.cumsum(new) - 1]
