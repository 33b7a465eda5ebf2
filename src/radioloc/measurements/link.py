"""Who transmits, which target answers, who receives; the names under which points on the Moon go."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace

from radioloc.earth.stations import StationCatalogue, station_name
from radioloc.errors import InputError

MAX_NAME_LENGTH = 80  # characters of a name of a station or a target, which also names files
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
    """The participants of a measurement.

    Four forms, written as paths: ``A>target>B``, a signal from station A over the target to station B (two-way where
    they are the same, else three-way); ``target>B``, the target's own signal, one-way; ``A<target>B``, the target's
    signal at two stations, a baseline; ``A<first|second>B``, the signals of two targets at a baseline's two stations.

    Parameters
    ----------
    transmitter : str
        The first station; empty where there is none (one-way).
    target, receiver : str
        Names without spaces at the ends and without ``<``, ``>``, ``|``, ``,``, ``#`` or quotes.
    differenced : bool
        The link is a baseline: both stations receive.
    second_target : str
        The target whose measurement is subtracted; empty as a rule.

    Raises
    ------
    InputError
        A name is empty, too long or holds a character that a path cannot, the link is of none of the four forms, or a
        baseline has one station only.
    """

    transmitter: str
    target: str
    receiver: str
    differenced: bool = False
    second_target: str = ""

    def __post_init__(self) -> None:
        names = [self.target, self.receiver]
        names += [name for name in (self.transmitter, self.second_target) if name]
        for name in names:
            if not name or name != name.strip() or any(c in '<>|,#"' or not c.isprintable() for c in name):
                raise InputError(
                    f"{name!r} cannot name a station or a target; "
                    "give printable text without '<', '>', '|', ',', '#' or quotes"
                )
        if max(map(len, names)) > MAX_NAME_LENGTH:
            longest = max(names, key=len)
            raise InputError(f"{longest!r} is too long a name; give up to {MAX_NAME_LENGTH} characters")
        if self.differenced and self.transmitter == self.receiver:
            raise InputError(f"{self.path} is a baseline of one station; name two")
        if (self.differenced and not self.transmitter) or (self.second_target and not self.differenced):
            raise InputError("a link of a baseline, and only it, has two stations and can have two targets")

    @property
    def form(self) -> str:
        """How the path is written: the form that a measurement type asks for."""
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
        """The receiving station, or the two of a baseline (``SESHAN25–KUNMING``): what groups residuals."""
        return f"{self.transmitter}\N{EN DASH}{self.receiver}" if self.differenced else self.receiver

    @property
    def stations(self) -> tuple[str, ...]:
        """The stations at its ends, the first one first; one name where the target itself transmits."""
        return (self.transmitter, self.receiver) if self.transmitter else (self.receiver,)

    @property
    def reception_signs(self) -> dict[str, float]:
        """Each station, and the sign of the delay of its reception in the value; 0 where it only transmits."""
        first = {self.transmitter: -1.0 if self.differenced else 0.0} if self.transmitter else {}
        return first | {self.receiver: 1.0}

    @property
    def targets(self) -> tuple[str, ...]:
        """The target, or the two."""
        return (self.target, self.second_target) if self.second_target else (self.target,)

    @classmethod
    def from_path(cls, path: str) -> Link:
        """Read a path in one of the four forms.

        Raises
        ------
        InputError
            The text is of none of the forms.
        """
        match = _PATH.fullmatch(path)
        if match is None:
            raise InputError(
                f"{path!r} is not a path; write it as transmitter>target>receiver, target>receiver, "
                "station1<target>station2 or station1<target1|target2>station2"
            )
        first, arrow, target, second_target, second = (part and part.strip() for part in match.groups())
        return cls(first or "", target, second, arrow == "<", second_target or "")

    def named(self, catalogue: StationCatalogue | None) -> Link:
        """The same link with canonical names of the targets, and those of the catalogue of stations that it knows."""
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
