"""Which station transmitted in a pass, as told by the residuals of candidates."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

DECISIVE = 1.5
"""Ratio of the second smallest rms to the smallest from which on a pass is decided."""


@dataclass(frozen=True, slots=True)
class TransmitterPass:
    """Candidates for the transmitter, and the turnaround ratio, of what a station received in a pass.

    Parameters
    ----------
    receiver : str
        The station.
    first_utc, last_utc : str
        First and last count.
    count : int
        Counts of Doppler.
    taken : str
        The candidate that the fit has.
    rms_m_s : mapping of str to float or None
        Rms of the residual rates by candidate, less one frequency offset, m/s of the round trip; None where the
        candidate does not see the target.
    cycle_m : float or None
        Wavelength of the signal on its way down, m.
    """

    receiver: str
    first_utc: str
    last_utc: str
    count: int
    taken: str
    rms_m_s: Mapping[str, float | None]
    cycle_m: float | None

    @property
    def ranking(self) -> list[str]:
        """Candidates that see the target, the smallest rms first."""
        known = {name: rms_m_s for name, rms_m_s in self.rms_m_s.items() if rms_m_s is not None}
        return sorted(known, key=lambda name: known[name])

    @property
    def decided(self) -> bool:
        """Whether the candidate that was taken fits much better than all others."""
        best, *others = self.ranking or [""]
        if best != self.taken:
            return False
        smallest, *rest = ((self.rms_m_s[name] or 0.0) for name in (best, *others))
        return all(rms_m_s >= DECISIVE * smallest for rms_m_s in rest)

    def size(self, name: str) -> str:
        """Rms of a candidate, in hertz where the wavelength is known; a dash where it does not see the target."""
        rms_m_s = self.rms_m_s[name]
        if rms_m_s is None:
            return "-"
        return f"{rms_m_s:.3g} m/s" if self.cycle_m is None else f"{rms_m_s / self.cycle_m:.3g} Hz"

    def __str__(self) -> str:
        """Say that no candidate fits much better than the others."""
        sizes = ", ".join(f"{name} {self.size(name)}" for name in self.ranking)
        return (
            f"who transmitted to {self.receiver} from {self.first_utc} to {self.last_utc} UTC is undecided ({sizes}); "
            f"{self.taken} was taken"
        )

    def to_dict(self) -> dict[str, Any]:
        """Its fields, and whether it is decided."""
        return asdict(self) | {"rms_m_s": dict(self.rms_m_s), "decided": self.decided}
