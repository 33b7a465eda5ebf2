"""Bands of deep-space links, S, X and Ka: their frequencies, and by what a transponder multiplies the uplink's.

Source: DSN Telecommunications Link Design Handbook (810-005), module 201, tables of channels and turnaround ratios; the
same ratios in Moyer (2003), table 13-1.
"""

from __future__ import annotations

from fractions import Fraction

UPLINK = {"S": 221, "X": 749, "Ka": 3599}
"""Uplinks of one channel are to each other as these numbers."""
DOWNLINK = {"S": 240, "X": 880, "Ka": 3344}
"""Coherent downlinks of the channel, on the scale of its uplinks."""
DOWNLINK_LIMITS_HZ = {"S": (2.20e9, 2.31e9), "X": (8.40e9, 8.50e9), "Ka": (31.8e9, 32.3e9)}


def turnaround_ratio(uplink: str, downlink: str) -> Fraction:
    """Ratio of the coherent downlink's frequency to the uplink's, of bands by their names.

    Examples
    --------
    >>> from radioloc.measurements.bands import turnaround_ratio
    >>> turnaround_ratio("X", "Ka")
    Fraction(3344, 749)
    """
    return Fraction(DOWNLINK[downlink], UPLINK[uplink])
