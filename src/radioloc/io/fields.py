"""Fields of comma-separated text, taken apart by the hundred thousand without a Python object for each.

Eight bytes of text are one 64-bit word, read little-endian at any offset: the first character is the lowest byte.
Digits of a word become a number by three multiplications that add neighbours, as in 12 34 -> 1234.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Places = NDArray[np.int64]
"""Offsets into a text, one for each row."""
Words = NDArray[np.uint64]

_PAD = 32
"""Zero bytes on both sides of the text, so that words may be read that begin before or end after it."""
MOST_DIGITS = 24
"""Digits that one number may have, in three words."""
POWERS = np.array([10**k for k in range(20)], dtype=np.uint64)
"""Powers of ten that 64 bits hold."""

_COMMA, _NEW_LINE, _QUOTE, _SPACE = (ord(c) for c in ',\n" ')
_ONES = 0x0101010101010101
# For 0 to 8 characters at the begin of a word: the bits they have.
_FIRST = np.array([(1 << 8 * k) - 1 for k in range(9)], dtype=np.uint64)
# What makes a digit the number 0 to 9, and what then carries into the highest bit of any other character.
_ZEROS = np.uint64(ord("0") * _ONES)
_BEYOND_NINE = np.uint64((0x80 - 10) * _ONES)
_HIGHEST_BITS = np.uint64(0x80 * _ONES)
# Odd, with its ones well spread: the golden ratio in 64 bits.
_MIX = np.uint64(0x9E3779B97F4A7C15)


class NotPlainError(ValueError):
    """A text is not of the form that is read in bulk; it may be of another, or wrong."""


class Fields:
    """Lines of text of so many fields each.

    Parameters
    ----------
    text : bytes
        Lines, each ended by a line feed.
    columns : int
        Fields that each line has.

    Raises
    ------
    NotPlainError
        A line has another number of fields, or there are quotes.
    """

    def __init__(self, text: bytes, columns: int) -> None:
        padded = bytearray(_PAD)
        padded += text
        padded += bytes(_PAD)
        self._text = padded
        self.characters = np.frombuffer(padded, dtype=np.uint8)
        self._words: Words = np.ndarray(len(padded) - 7, dtype="<u8", buffer=padded, strides=(1,))
        # One comparison finds separators and little else.
        found = np.flatnonzero(self.characters[_PAD:-_PAD] <= _COMMA) + _PAD
        mark = self.characters[found]
        is_separator = (mark == _COMMA) | (mark == _NEW_LINE)
        self._has_spaces = False
        if not is_separator.all():
            if (mark == _QUOTE).any():
                raise NotPlainError("quotes")
            self._has_spaces = bool((mark == _SPACE).any())
            found, mark = found[is_separator], mark[is_separator]
        if found.size % columns:
            raise NotPlainError("fields")
        mark = mark.reshape(-1, columns)
        if (mark[:, :-1] != _COMMA).any() or (mark[:, -1] != _NEW_LINE).any():
            raise NotPlainError("fields")
        # Column by column; in front the line's begin, behind the end of the line before.
        self._end = np.empty((columns + 1, len(mark)), dtype=np.int64)
        self._end[1:] = found.reshape(-1, columns).T
        self._end[0, :1] = _PAD - 1
        self._end[0, 1:] = self._end[-1, :-1]

    def __len__(self) -> int:
        return self._end.shape[1]

    def column(self, index: int) -> tuple[Places, Places]:
        """Where the fields of a column begin and end, spaces around them left out; each of shape (n,)."""
        start, end = self._end[index] + 1, self._end[index + 1]
        if self._has_spaces:
            end = end.copy()
            while (blank := (self.characters[start] == _SPACE) & (start < end)).any():
                start += blank
            while (blank := (self.characters[end - 1] == _SPACE) & (start < end)).any():
                end -= blank
        return start, end

    def first(self, character: str, start: Places, end: Places) -> Places:
        """Place of the first such character in texts from start to end, or the end; shape (n,)."""
        wanted = np.uint64(ord(character) * _ONES)
        place = start.copy()
        for _ in range(-(-int((end - start).max(initial=0)) // 8)):
            differs = self._words[np.minimum(place, end)] ^ wanted
            # The lowest bit that is set here is the highest of the first zero byte.
            zero = (differs - np.uint64(_ONES)) & ~differs & _HIGHEST_BITS
            # Where the character stands already nothing is added, where it is not there 8.
            place += np.bitwise_count((zero - np.uint64(1)) & ~zero) >> 3
        return np.minimum(place, end)

    def field(self, start: int, end: int) -> bytes:
        """Text from one place to another."""
        return bytes(self._text[start:end])

    def window(self, start: Places, width: int) -> NDArray[np.uint8]:
        """Characters from places on, shape (n, width); width up to 32."""
        windows = np.ndarray(
            (len(self._text) - width + 1, width), dtype=np.uint8, buffer=self._text, strides=(1, 1)
        )
        chosen: NDArray[np.uint8] = windows[start]
        return chosen

    def unsigned(self, end: Places, digits: Places | int) -> tuple[Words, NDArray[np.bool_]]:
        """Numbers of so many digits that end at these places.

        Parameters
        ----------
        end : ndarray of int64, shape (n,)
            The places after the last digits.
        digits : ndarray of int64, shape (n,) or int
            How many there are, 0 to 24; none is zero.

        Returns
        -------
        value : ndarray of uint64, shape (n,)
        plain : ndarray of bool, shape (n,)
            Whether all were digits and the number is below 1e19; otherwise the value means nothing.
        """
        most = int(np.max(digits, initial=0))
        value = np.zeros(end.shape, dtype=np.uint64)
        odd = np.zeros(end.shape, dtype=np.uint64)
        for k in range(-(-most // 8)):
            word = self._words[end - 8 * (k + 1)] ^ _ZEROS
            # What stands before the digits leaves the word at its low end, and comes back as zeros.
            before = np.clip(64 * (k + 1) - 8 * digits, 0, 64).astype(np.uint64)
            word = word >> before << before
            odd |= word | word + _BEYOND_NINE
            part = _eight_digits(word)
            if k == 2:
                odd |= np.where(part < 1000, 0, _HIGHEST_BITS)
            value += part * POWERS[8 * k]
        return value, (odd & _HIGHEST_BITS) == 0

    def first_words(self, start: Places, end: Places) -> list[Words]:
        """Texts as words, filled with zero bytes: as many words, each of shape (n,), as the longest needs."""
        length = end - start
        words = []
        for k in range(-(-int(length.max(initial=0)) // 8)):
            here = np.clip(length - 8 * k, 0, 8)
            # Of a text that ended before, nothing is asked; its place may lie behind all text.
            words.append(self._words[np.minimum(start + 8 * k, end)] & _FIRST[here])
        return words


class TextCodes:
    """The different texts of a column, numbered as they first come, block by block."""

    def __init__(self) -> None:
        self.texts: list[str] = []
        self._hash = np.empty(0, dtype=np.uint64)
        self._code = np.empty(0, dtype=np.int64)

    def codes(self, fields: Fields, index: int) -> NDArray[np.int64]:
        """Indices into ``texts``, shape (n,); texts that are new are added.

        Raises
        ------
        NotPlainError
            Two texts have the same hash.
        """
        start, end = fields.column(index)
        words = fields.first_words(start, end)
        mixed = (end - start).astype(np.uint64)
        for word in words:
            mixed = (mixed ^ word) * _MIX
            mixed ^= mixed >> np.uint64(32)
        row = self._rows(mixed)
        if row is None:
            _, first = np.unique(mixed, return_index=True)
            for k in np.sort(first):
                if mixed[k] not in self._hash:
                    self.texts.append(fields.field(int(start[k]), int(end[k])).decode())
                    self._hash = np.append(self._hash, mixed[k])
                    self._code = np.append(self._code, len(self.texts) - 1)
            order = np.argsort(self._hash)
            self._hash, self._code = self._hash[order], self._code[order]
            row = self._rows(mixed)
            assert row is not None
        code = self._code[row]
        self._require_same(code, end - start, words)
        return code

    def _rows(self, mixed: Words) -> Places | None:
        """Where the hashes stand in the sorted list; None if one is not there."""
        if not len(self._hash):
            return None
        row = np.minimum(np.searchsorted(self._hash, mixed), len(self._hash) - 1)
        return row if (self._hash[row] == mixed).all() else None

    def _require_same(self, code: NDArray[np.int64], length: Places, words: list[Words]) -> None:
        """Raise where a text is not that of its code: one hash for two texts."""
        encoded = [text.encode() for text in self.texts]
        same = np.array([len(text) for text in encoded])[code] == length
        for k, word in enumerate(words):
            of_code = np.frombuffer(b"".join(t[8 * k : 8 * k + 8].ljust(8, b"\0") for t in encoded), "<u8")
            same &= of_code[code] == word
        if not same.all():
            raise NotPlainError("hash")


def _eight_digits(word: Words) -> Words:
    """Number that eight numbers from 0 to 9 make."""
    pairs = word * np.uint64(10 * 2**8 + 1) >> np.uint64(8)
    fours = (pairs & np.uint64(0x00FF00FF00FF00FF)) * np.uint64(100 * 2**16 + 1) >> np.uint64(16)
    return (fours & np.uint64(0x0000FFFF0000FFFF)) * np.uint64(10000 * 2**32 + 1) >> np.uint64(32)
