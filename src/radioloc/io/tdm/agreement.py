"""Agreements between agencies that complement Tracking Data Messages.

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
"""Conventions of RANGE and DOPPLER_*: the round trip or half of it (annex D, items 31 and 32)."""


@dataclass(frozen=True, slots=True)
class TdmAgreement:
    """Agreement on the content of messages that they do not state themselves.

    Raises
    ------
    InputError
        A value is out of range or unknown.
    """

    #: Standard deviation by type of observation (``"range"``, ``"vlbi_delay"``, ``"doppler"``, ...), m; the
    #: standard lacks a keyword for it. For two- and three-way ranges that of the round trip, for Doppler that of
    #: the range difference over the count interval.
    sigma_m: Mapping[str, float] = field(default_factory=dict)
    #: "round_trip", "half": whether RANGE of a two- or three-way path is the light path of the round trip, or
    #: half of it.
    range_convention: str = "round_trip"
    #: "round_trip", "half": whether DOPPLER_INTEGRATED and DOPPLER_INSTANTANEOUS of such a path are its rate, or
    #: half of it.
    doppler_convention: str = "round_trip"
    #: Length of one range unit (RANGE_UNITS = RU), s of time of flight, of RANGE by its convention; where the
    #: unit follows a changing transmitted frequency, at the first frequency of the message.
    range_unit_s: float | None = None
    #: Numerator and denominator of the transponder's ratio of downlink to uplink frequency, where the file does
    #: not state it.
    turnaround: tuple[int, int] | None = None
    #: Whether TRANSMIT_DELAY_n and RECEIVE_DELAY_n are already removed from data and time tags (item 14).
    delays_removed: bool = False
    #: Delays of the model, of the transponder or of a station on the way out or in; the same delays of a file
    #: stay in its data, so that they count once.
    modelled: EquipmentDelays = field(default_factory=EquipmentDelays)
    #: Whether to correct time tags, VLBI delays and ranges between two clocks by CLOCK_BIAS and CLOCK_DRIFT.
    apply_clocks: bool = True
    lunar: bool = True  #: whether the target is at the Moon, so that ranges of another length are errors
    #: Transmitted frequencies of messages with RECEIVE_FREQ only; the first that holds for a file counts. With a
    #: transmitter, one-way paths are three-way.
    frequencies: tuple[FrequencyAgreement, ...] = ()

    def __post_init__(self) -> None:
        convert_fields(self)
        for kind, sigma in self.sigma_m.items():
            if kind not in TYPES:
                raise InputError(f"sigma_m: expected types {', '.join(TYPES)}, got {kind!r}")
            if not (math.isfinite(sigma) and sigma > 0.0):
                raise InputError(f"sigma_m: expected metres above zero of {kind}, got {sigma}")
        for name in ("range_convention", "doppler_convention"):
            if getattr(self, name) not in CONVENTIONS:
                raise InputError(f"{name}: expected {' or '.join(CONVENTIONS)}, got {getattr(self, name)!r}")
        unit = self.range_unit_s
        if unit is not None and not (math.isfinite(unit) and unit > 0.0):
            raise InputError(f"range_unit_s: expected seconds above zero, got {unit}")
        require_ratio(self.turnaround)
