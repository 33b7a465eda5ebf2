"""Values of a JSON file by their keys, checked, with errors that name file and key."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radioloc.errors import FileFormatError

Floats = NDArray[np.float64]

_LARGEST = 1e15  # number in a file: in seconds or kilometres it is out of this world
_ABSENT = object()


class Keys:
    """Values of a file by their path, with errors that name file and key."""

    def __init__(self, path: str | Path, content: Any, holder: str = "an ISD of a sensor model") -> None:
        self.path = path
        self.content = content
        self.holder = holder

    def get(self, name: str, default: Any = None) -> Any:
        """The value of a key such as ``detector_center.line``; without a default the key has to be there."""
        value = self.content
        for part in name.split("."):
            if not isinstance(value, dict) or part not in value:
                if default is not None:
                    return default
                raise FileFormatError(self.path, f"the key {name} is missing; {self.holder} has it")
            value = value[part]
        return value

    def has(self, name: str) -> bool:
        """Whether there is such a key."""
        return isinstance(self.content, dict) and self.get(name, _ABSENT) is not _ABSENT

    def text(self, name: str, default: str | None = None) -> str:
        """A text."""
        return str(self.get(name, default))

    def numbers(self, name: str, shape: tuple[int | None, ...], default: Any = None) -> Floats:
        """An array of finite numbers; of lengths that are None there may be any number."""
        value = self.get(name, default)
        try:
            array = np.array(value, dtype=np.float64)
        except (TypeError, ValueError):
            array = np.array(np.nan)
        fits = array.ndim == len(shape) and all(
            want in (None, got) for want, got in zip(shape, array.shape, strict=True)
        )
        if not fits or not (np.abs(array) < _LARGEST).all():
            size = " by ".join("n" if one is None else str(one) for one in shape)
            what = f"{size} finite numbers" if shape else "a finite number"
            raise FileFormatError(self.path, f"{name} is not {what}, as a camera has")
        return array

    def number(self, name: str, default: float | None = None) -> float:
        """One finite number."""
        return float(self.numbers(name, (), default))

    def count(self, name: str) -> int:
        """A positive whole number."""
        value = self.number(name)
        if value < 1.0 or value != int(value):
            raise FileFormatError(self.path, f"{name} = {value:g} is not a positive whole number")
        return int(value)
