"""Who sends, who answers and who receives, from a segment's MODE, PATH and participants.

Modelled are two- and three-way paths (MODE = SEQUENTIAL, PATH = station, target, station) and the difference of
two paths that are the same but for their last station (MODE = SINGLE_DIFF): a delay between two stations.
Everything else is refused.
"""

from __future__ import annotations

from dataclasses import dataclass

from radioloc.errors import FileFormatError, InputError, StationError
from radioloc.io.checks import Catalogue
from radioloc.io.tdm_file import TdmSegment
from radioloc.measurements.link import Link
from radioloc.measurements.targets import canonical_target


@dataclass(frozen=True, slots=True)
class SignalPath:
    """Path of the signal that a segment's data are of.

    Parameters
    ----------
    link : Link
        Stations and target by name.
    first, target, second : int
        Numbers of the participants: transmitter, target, receiver; or first station, target, second station.
    """

    link: Link
    first: int
    target: int
    second: int


@dataclass(frozen=True, slots=True)
class Names:
    """Names of participants as the catalogue writes them.

    Parameters
    ----------
    catalogue : Catalogue or None
        Stations; without one, names stay as they are.
    """

    catalogue: Catalogue | None

    def station(self, path: str, segment: TdmSegment, number: int) -> str:
        """Name of a participant that must be a station.

        Raises
        ------
        FileFormatError
            The catalogue does not know it.
        """
        name = participant(segment, number)
        if self.catalogue is None:
            return name
        try:
            return str(self.catalogue.get(name).name)
        except StationError as error:
            keyword = f"PARTICIPANT_{number}"
            raise FileFormatError(path, f"{keyword}: {error}", segment.line_of(keyword)) from None

    def key(self, name: str) -> str:
        """Text by which the same participant is known again in another segment.

        Case does not matter, and an underscore is a blank (4.3.7, 4.3.8).
        """
        if self.catalogue is not None:
            try:
                return str(self.catalogue.get(name).name).casefold()
            except StationError:
                pass
        return " ".join(canonical_target(name).replace("_", " ").split())


def participant(segment: TdmSegment, number: int) -> str:
    """Name of a participant as the file gives it."""
    return segment.metadata[f"PARTICIPANT_{number}"]


def numbers(segment: TdmSegment, keyword: str = "PATH") -> list[int]:
    """Participants of a path, in order; empty where the segment has no such path."""
    return [int(number) for number in segment.metadata.get(keyword, "").split(",") if number]


def signal_path(path: str, segment: TdmSegment, names: Names, *, delay: bool) -> SignalPath:
    """Path of the signal of a segment.

    Parameters
    ----------
    path : str
        The file, for messages.
    segment : TdmSegment
        The segment.
    names : Names
        How participants are called.
    delay : bool
        Whether the data are VLBI_DELAY or DOR rather than of one path.

    Raises
    ------
    FileFormatError
        MODE or PATH is missing, contradicts the other or the data, or is one that is not modelled; a station is
        not in the catalogue.
    """

    def fail(problem: str, keyword: str) -> FileFormatError:
        return FileFormatError(path, problem, segment.line_of(keyword))

    mode = segment.metadata.get("MODE")
    if mode is None:
        raise fail("the metadata have no MODE, which the data need; add MODE = SEQUENTIAL or SINGLE_DIFF", "")
    if delay != (mode == "SINGLE_DIFF"):
        held = (
            "VLBI_DELAY or DOR" if delay else "data that are differences of two paths (RANGE, DOPPLER, ...)"
        )
        rule = (
            "goes with MODE = SINGLE_DIFF"
            if delay
            else "are not modelled; differenced are only VLBI_DELAY and DOR"
        )
        raise fail(f"MODE is {mode}, but {held} {rule}", "MODE")
    wanted = ("PATH_1", "PATH_2") if delay else ("PATH",)
    for keyword in wanted:
        if keyword not in segment.metadata:
            raise fail(f"MODE is {mode}, but there is no {keyword}; add it", "MODE")
    paths = [numbers(segment, keyword) for keyword in wanted]
    shown = " and ".join(f"{keyword} = {segment.metadata[keyword]}" for keyword in wanted)
    if delay:
        first, second = paths[0][-1], paths[1][-1]
        if paths[0][:-1] != paths[1][:-1] or len(paths[0]) > 3 or first == second:
            problem = (
                "is not modelled; a delay has two paths alike but for the last station, such as 1,2 and 1,3"
            )
            raise fail(f"{shown} {problem}", "PATH_1")
        target = paths[0][-2]
    else:
        if len(paths[0]) != 3:
            ways = "one-way" if len(paths[0]) == 2 else "four-way or longer"
            problem = "is not modelled; a path goes from a station over the target to a station, such as 1,2,1 or 1,2,3"
            raise fail(f"{shown} is {ways}, which {problem}", "PATH")
        first, target, second = paths[0]
    if target in (first, second):
        raise fail(f"{shown} has the target among the stations; correct it", wanted[0])
    if participant(segment, target).upper() == "UNKNOWN":
        raise fail("the target is UNKNOWN; name the point on the Moon", f"PARTICIPANT_{target}")
    try:
        link = Link(
            names.station(path, segment, first),
            canonical_target(participant(segment, target)),
            names.station(path, segment, second),
            delay,
        )
    except FileFormatError:
        raise
    except InputError as error:
        raise fail(str(error), f"PARTICIPANT_{target}") from None
    if delay and link.transmitter == link.receiver:
        raise fail(f"{shown} end at one station, {link.receiver}; a delay needs two", "PATH_2")
    return SignalPath(link, first, target, second)
