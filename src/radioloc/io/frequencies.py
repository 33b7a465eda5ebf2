"""Received frequencies: what their files do not say of the signal, and what they are in metres.

With light time tau(t) at reception t, the phase that arrives at t left the transmitter at t - tau(t), multiplied by the
transponder's ratio M. Of a frequency f that is sent, the mean received frequency F over the count interval T from t0 on
obeys F T = M f [T - (tau(t0 + T) - tau(t0))]: the light path has grown by c T (1 - F / (M f)), whatever the light time
(Moyer 2003, section 13.3). An oscillator that is off by a part y of its frequency adds -c T y: the parameter
``frequency_offset`` by link and pass, or one-way ``target_frequency``.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePath
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from radioloc.boundary import bare_fields
from radioloc.constants import C_M_S
from radioloc.earth.stations import StationCatalogue
from radioloc.errors import FileFormatError, InputError
from radioloc.measurements.link import Link
from radioloc.measurements.observations import Observations, without_duplicates
from radioloc.measurements.registry import KINDS
from radioloc.time.dates import utc_from_seconds_of_day

LONGEST_S = 86400.0
"""Longest delay, count interval, light time or clock difference that is believed, s."""
MICROMETRES = 1e6
_FASTEST_M_S = 3e5


@dataclass(frozen=True, slots=True)
class FrequencyAgreement:
    """What must be known to turn received frequencies into Doppler and is not in their files.

    Parameters
    ----------
    transmit_hz : float or Quantity
        Frequency that is sent, Hz: of the target's oscillator as it should be, or of a transmitter's uplink.
    sigma_hz : float or Quantity
        Standard deviation of a received frequency, the mean over a count interval, Hz.
    count_s : float or Quantity, optional
        Count interval, s: how long a reading was integrated, about its time tag; where the file does not say.
    target : str
        Whose signal it is, by its name in the observations.
    transmitter : str
        The station that sends up, of a three-way signal (two-way where it receives, too); empty of one that the target
        generates.
    turnaround : tuple of int, optional
        With a transmitter, numerator and denominator of the transponder's ratio of downlink to uplink frequency.
    files : str or iterable of str, optional
        Names or globs of the files that it holds for; all where ``None``.

    Raises
    ------
    InputError
        A value is not one that can be, or a transmitter has no turnaround ratio or none is there for a ratio.
    """

    transmit_hz: float
    sigma_hz: float
    count_s: float | None = None
    target: str = "lander"
    transmitter: str = ""
    turnaround: tuple[int, int] | None = None
    files: tuple[str, ...] | None = None

    def __post_init__(self) -> None:
        bare_fields(self)
        if isinstance(self.files, str):
            object.__setattr__(self, "files", (self.files,))
        for name in ("transmit_hz", "sigma_hz", "count_s"):
            value = getattr(self, name)
            if value is not None and not (math.isfinite(value) and value > 0.0):
                raise InputError(f"{name} = {value}, but must be finite and above zero")
        if self.count_s is not None and self.count_s > LONGEST_S:
            raise InputError(
                f"count_s = {self.count_s}, but no count interval is longer than a day, in seconds"
            )
        require_ratio(self.turnaround)
        if bool(self.transmitter) != (self.turnaround is not None):
            rule = "the ratio is that of the transponder that answers a station's signal"
            raise InputError(f"transmitter and turnaround go together: {rule}; give both or neither")
        Link(self.transmitter, self.target, "receiver")

    @property
    def ratio(self) -> tuple[int, int]:
        """Downlink to uplink frequency, 1/1 of the target's own signal."""
        return self.turnaround or (1, 1)

    @property
    def received_hz(self) -> float:
        """Frequency that a station would receive of a target at rest, Hz."""
        return self.transmit_hz * self.ratio[0] / self.ratio[1]


class Reading(NamedTuple):
    """A received frequency as a line of a file says it.

    Midnight (Julian date, UTC) and second of the day of the middle of the count, at reception; the mean frequency, Hz;
    the line; transmitter and receiver as the file names them, of which an empty transmitter is the agreement's.
    """

    midnight: float
    second_of_day: float
    received_hz: float
    line: int
    ends: tuple[str, str]


def require_ratio(turnaround: tuple[int, int] | None) -> None:
    """Refuse a turnaround ratio that is none."""
    whole = turnaround is None or (
        len(turnaround) == 2 and all(isinstance(x, int) and x > 0 for x in turnaround)
    )
    if not whole:
        raise InputError(f"turnaround = {turnaround!r}; give two whole numbers such as (880, 749)")


def agreement_on(path: str | Path, agreements: Iterable[FrequencyAgreement]) -> FrequencyAgreement | None:
    """The first of some agreements that holds for a file."""
    matching = (
        a for a in agreements if a.files is None or any(PurePath(path).match(name) for name in a.files)
    )
    return next(matching, None)


def growth_s(
    received_hz: NDArray[np.float64], offset_hz: float, sent_hz: float, ratio: tuple[int, int], count_s: float
) -> NDArray[np.float64]:
    """By how much the light time grows over count intervals, s, from mean received frequencies less an offset.

    Growth that nothing in space has is NaN: then the frequency sent or the ratio is another.
    """
    up, down = ratio
    # Differences of nearly equal frequencies first: the digits that cancel are then gone without loss.
    part = ((up * sent_hz - down * offset_hz) - down * received_hz) / (up * sent_hz)
    return np.where(np.abs(part) < _FASTEST_M_S / C_M_S, count_s * part, np.nan)


def frequency_observations(
    path: str | Path,
    agreements: Sequence[FrequencyAgreement],
    catalogue: StationCatalogue | None,
    readings: Sequence[Reading],
    *,
    offset_hz: float = 0.0,
    count_s: float | None = None,
) -> Observations:
    """Doppler of the received frequencies of one file.

    Parameters
    ----------
    path : path-like
        The file.
    agreements : sequence of FrequencyAgreement
        Of which the first that holds for the file counts.
    catalogue : StationCatalogue or None
        Gives stations their catalogue names.
    readings : sequence of Reading
        What the lines of the file say.
    offset_hz : float
        What is to be added to their frequencies, Hz.
    count_s : float, optional
        Count interval that the file states, s; that of the agreement goes first.

    Raises
    ------
    FileFormatError
        There are no readings, no agreement holds for the file, nothing says the count interval, or a frequency cannot
        be of that signal.

    Warns
    -----
    DataQualityWarning
        An epoch is there twice, and its first frequency counted.
    """
    if not readings:
        raise FileFormatError(path, "has no readings; fetch it again")
    midnight, second_of_day, hz, lines, stations = zip(*readings, strict=True)
    received_hz, line = np.array(hz), np.array(lines, dtype=np.int32)
    places = {ends: k for k, ends in enumerate(dict.fromkeys(stations))}
    station = np.array([places[ends] for ends in stations], dtype=np.int32)
    its = agreement_on(path, agreements)
    if its is None:
        problem = "holds received frequencies, but not what was sent; say transmit_hz and sigma_hz under"
        raise FileFormatError(path, f"{problem} [[observations.frequencies]] (FrequencyAgreement in Python)")
    count_s = its.count_s or count_s
    if count_s is None:
        problem = "does not say how long a frequency was integrated; say count_s"
        raise FileFormatError(path, f"{problem} under [[observations.frequencies]]")
    grown_s = growth_s(received_hz, offset_hz, its.transmit_hz, its.ratio, count_s)
    if np.isnan(grown_s).any():
        row = int(np.argmax(np.isnan(grown_s)))
        problem = (
            f"{float(offset_hz + received_hz[row])!r} Hz cannot be received of {its.transmit_hz!r} Hz sent"
        )
        advice = "correct the frequency, transmit_hz or turnaround"
        raise FileFormatError(
            path, f"{problem} and the ratio {its.ratio[0]}/{its.ratio[1]}; {advice}", int(line[row])
        )
    links = [Link(up or its.transmitter, its.target, down).named(catalogue) for up, down in places]
    one_way = np.array([not link.transmitter for link in links])[station]
    observations = Observations.from_columns(
        epoch=utc_from_seconds_of_day(np.array(midnight), np.array(second_of_day)),
        links=links,
        link=station,
        tag=1,
        kind=np.where(one_way, KINDS.index("one_way_doppler"), KINDS.index("doppler")),
        value_m=C_M_S * grown_s,
        sigma_m=C_M_S * count_s * its.sigma_hz / its.received_hz,
        count_s=count_s,
        uplink_hz=np.where(one_way, np.nan, its.transmit_hz),
        wavelength_um=MICROMETRES * C_M_S / its.received_hz,
        files=(str(path),),
        line=line,
    )
    return without_duplicates(observations, first_counts=True)
