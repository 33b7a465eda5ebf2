"""What a Tracking Data Message leaves to be agreed between the agencies that exchange it, or does not say at all.

Source: CCSDS 503.0-B-2 (2020), annex D.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from radioloc.errors import InputError
from radioloc.io.frequencies import FrequencyAgreement, require_ratio
from radioloc.io.tdm.message import TYPES
from radioloc.measurements.equipment_delays import EquipmentDelays
from radioloc.quantities import convert_fields

CONVENTIONS = ("round_trip", "half")
"""Whether RANGE and DOPPLER_* mean the round trip or half of it (annex D, items 31 and 32)."""


@dataclass(frozen=True, slots=True)
class TdmAgreement:
    """What must be known to turn a message into observations and is not in it.

    Parameters
    ----------
    sigma_m : mapping of str to float
        Standard deviation of each type of observation (``"range"``, ``"vlbi_delay"``, ``"doppler"``, ...), m: the
        standard has no keyword for it. Of the round trip where there is one, and for Doppler of the range difference
        over the count interval.
    range_convention : {"round_trip", "half"}
        What RANGE of a two- or three-way path is: the light path there and back, or half of it.
    doppler_convention : {"round_trip", "half"}
        What DOPPLER_INTEGRATED and DOPPLER_INSTANTANEOUS of such a path are: its rate, or half of it.
    range_unit_s : float, optional
        Length of one range unit (RANGE_UNITS = RU), s of time of flight, of whatever RANGE is by its convention; where
        the unit follows a transmitted frequency that changes, at the first of the message.
    turnaround : tuple of int, optional
        Numerator and denominator of the transponder's ratio of downlink to uplink frequency, where the file does
        not give it.
    delays_removed : bool
        TRANSMIT_DELAY_n and RECEIVE_DELAY_n are no longer in the data and time tags (item 14).
    modelled : EquipmentDelays
        Delays that the model has, of the transponder or of a station on the way out or in: those that a file states of
        them stay in its data, so that none counts twice.
    apply_clocks : bool
        Correct time tags, VLBI delays and ranges between two clocks by CLOCK_BIAS and CLOCK_DRIFT.
    lunar : bool
        Whether the target is at the Moon, so that a range of another length is a mistake.
    frequencies : tuple of FrequencyAgreement
        What was sent, where a message has RECEIVE_FREQ only: the first that holds for its file counts. A path that is
        one-way is three-way with its transmitter, its sigma is that of the received frequencies, and its target's name
        is passed over.

    Raises
    ------
    InputError
        A value is not one that can be.
    """

    sigma_m: Mapping[str, float] = field(default_factory=dict)
    range_convention: str = "round_trip"
    doppler_convention: str = "round_trip"
    range_unit_s: float | None = None
    turnaround: tuple[int, int] | None = None
    delays_removed: bool = False
    modelled: EquipmentDelays = field(default_factory=EquipmentDelays)
    apply_clocks: bool = True
    lunar: bool = True
    frequencies: tuple[FrequencyAgreement, ...] = ()

    def __post_init__(self) -> None:
        convert_fields(self)
        for kind, sigma in self.sigma_m.items():
            if kind not in TYPES:
                known = ", ".join(TYPES)
                raise InputError(f"sigma_m: {kind!r} is not a kind of observation of a TDM; use {known}")
            if not (math.isfinite(sigma) and sigma > 0.0):
                raise InputError(f"sigma_m: {kind} is {sigma}, but must be finite and above zero, in metres")
        for name in ("range_convention", "doppler_convention"):
            if getattr(self, name) not in CONVENTIONS:
                raise InputError(f"{name} = {getattr(self, name)!r}; use {' or '.join(CONVENTIONS)}")
        unit = self.range_unit_s
        if unit is not None and not (math.isfinite(unit) and unit > 0.0):
            raise InputError(f"range_unit_s = {unit}, but must be finite and above zero, in seconds")
        require_ratio(self.turnaround)
