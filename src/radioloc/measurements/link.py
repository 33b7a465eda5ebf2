"""Participants of measurements, and the names of reflectors on the Moon."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace

from radioloc.earth.stations import StationCatalogue, station_name
from radioloc.errors import InputError

MAX_NAME_LENGTH = 80  # characters of names of stations and targets, which also name files
_PATH = re.compile(r"(?:([^<>|]+)([<>]))?([^<>|]+)(?:\|([^<>|]+))?>([^<>|]+)")
_ALIASES = {
    "apollo11": ("apollo 11", "ap11", "a11"),
    "apollo14": ("apollo 14", "ap14", "a14"),
    "apollo15": ("apollo 15", "ap15", "a15"),
    "luna17": ("luna 17", "lunokhod1", "lunokhod 1", "l1", "lk1"),
    "nglr1": ("nglr 1", "ngl1", "ngl 1"),
    "luna21": ("luna 21", "lunokhod2", "lunokhod 2", "l2", "lk2"),
}
REFLECTORS = tuple(sorted(_ALIASES))  # canonical names of the laser reflectors on the Moon

_CANONICAL = {alias: name for name, aliases in _ALIASES.items() for alias in (name, *aliases)}


@dataclass(frozen=True, slots=True, order=True)
class Link:
    """Participants of a measurement.

    Four forms, written as paths: ``A>target>B``, a signal from station A over the target to station B (two-way if the
    stations are equal, else three-way); ``target>B``, the target's signal, one-way; ``A<target>B``, the target's signal
    at two stations, a baseline; ``A<first|second>B``, the signals of two targets on a baseline.

    Raises
    ------
    InputError
        A name is empty, too long or has an excluded character, the form is invalid, or a baseline has equal stations.
    """

    transmitter: str  #: first station; empty for one-way
    #: Target and last station; names without spaces at the ends and without ``<``, ``>``, ``|``, ``,``, ``#`` or
    #: quotes.
    target: str
    receiver: str  #: likewise
    differenced: bool = False  #: whether the link is a baseline: both stations receive
    second_target: str = ""  #: target whose measurement is subtracted; empty by default

    def __post_init__(self) -> None:
        names = [self.target, self.receiver]
        names += [name for name in (self.transmitter, self.second_target) if name]
        for name in names:
            if not name or name != name.strip() or any(c in '<>|,#"' or not c.isprintable() for c in name):
                raise InputError(
                    f"name: expected printable text without '<', '>', '|', ',', '#' or quotes, got {name!r}"
                )
        if max(map(len, names)) > MAX_NAME_LENGTH:
            longest = max(names, key=len)
            raise InputError(f"name: expected up to {MAX_NAME_LENGTH} characters, got {longest!r}")
        if self.differenced and self.transmitter == self.receiver:
            raise InputError(f"{self.path}: expected two different stations of a baseline")
        if (self.differenced and not self.transmitter) or (self.second_target and not self.differenced):
            raise InputError("link: expected two stations for a baseline, and a second target only with it")

    @property
    def form(self) -> str:
        """Form of the path, as in :attr:`MeasurementType.form`."""
        if self.second_target:
            return "station1<target1|target2>station2"
        if self.differenced:
            return "station1<target>station2"
        return "transmitter>target>receiver" if self.transmitter else "target>receiver"

    @property
    def path(self) -> str:
        """Text such as ``APOLLO>apollo15>APOLLO``, ``lander>KASHI`` or ``SESHAN25<lander>KUNMING``."""
        first = f"{self.transmitter}{'<' if self.differenced else '>'}" if self.transmitter else ""
        second = f"|{self.second_target}" if self.second_target else ""
        return f"{first}{self.target}{second}>{self.receiver}"

    @property
    def place(self) -> str:
        """Receiving station, or both of a baseline (``SESHAN25–KUNMING``), by which residuals are grouped."""
        return f"{self.transmitter}\N{EN DASH}{self.receiver}" if self.differenced else self.receiver

    @property
    def stations(self) -> tuple[str, ...]:
        """Names of the first and the last station; a single name for one-way."""
        return (self.transmitter, self.receiver) if self.transmitter else (self.receiver,)

    @property
    def reception_signs(self) -> dict[str, float]:
        """Sign of the reception delay of each station in the value; 0 for a transmitter."""
        first = {self.transmitter: -1.0 if self.differenced else 0.0} if self.transmitter else {}
        return first | {self.receiver: 1.0}

    @property
    def targets(self) -> tuple[str, ...]:
        """Names of the target or of both targets."""
        return (self.target, self.second_target) if self.second_target else (self.target,)

    @classmethod
    def from_path(cls, path: str) -> Link:
        """Parse a path of the four forms.

        Raises
        ------
        InputError
            The text has another form.
        """
        match = _PATH.fullmatch(path)
        if match is None:
            raise InputError(
                "path: expected transmitter>target>receiver, target>receiver, station1<target>station2 or "
                f"station1<target1|target2>station2, got {path!r}"
            )
        first, arrow, target, second_target, second = (part and part.strip() for part in match.groups())
        return cls(first or "", target, second, arrow == "<", second_target or "")

    def with_canonical_names(self, catalogue: StationCatalogue | None) -> Link:
        """Return the link with canonical names of targets, and the catalogue's names of its stations."""
        target = canonical_target(self.target)
        return replace(
            self,
            transmitter=station_name(catalogue, self.transmitter) if self.transmitter else "",
            target=target,
            receiver=station_name(catalogue, self.receiver),
            second_target=canonical_target(self.second_target) if self.second_target else "",
        )


def canonical_target(name: str) -> str:
    """Return the ILRS name of a target, such as ``apollo15`` of ``"AP 15"``; an unknown name in lower case."""
    lower = " ".join(name.lower().split())
    return _CANONICAL.get(lower.replace("-", " ").replace("_", " "), lower)
