"""Choice of a study's observations: files, selection, and agreements on their content."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from radioloc.errors import InputError
from radioloc.io.frequencies import FrequencyAgreement
from radioloc.io.tdm import TdmAgreement
from radioloc.study.map_positions import PlaceOnMap
from radioloc.study.schema import check, entry
from radioloc.study.uplinks import Uplink
from radioloc.study.weights import Weight
from radioloc.time import Epochs, utc_to_tai
from radioloc.units import set_fields

TDM_KEYS = {
    "sigma_m": "sigma_m",
    "tdm_range": "range_convention",
    "tdm_doppler": "doppler_convention",
    "tdm_range_unit_s": "range_unit_s",
    "tdm_turnaround": "turnaround",
    "tdm_delays_removed": "delays_removed",
    "tdm_apply_clocks": "apply_clocks",
}
"""Keys of ``[observations]`` that are fields of :class:`~radioloc.io.tdm.TdmAgreement`."""


@dataclass(frozen=True, slots=True)
class ObservationChoice:
    """Keys of ``[observations]``, as the reference of the study file describes them, globs of files already resolved.

    The keys on Tracking Data Messages are those of `tdm` (:data:`TDM_KEYS`).
    """

    files: tuple[Path, ...] = ()
    targets: tuple[str, ...] | None = entry(None, names=True)
    stations: tuple[str, ...] | None = entry(None, names=True)
    target_names: Mapping[str, str] = entry(factory=dict)
    types: tuple[str, ...] | None = entry(None, names=True)
    start: Epochs | None = entry(None, moment=True)
    stop: Epochs | None = entry(None, moment=True)
    hours: float | None = entry(None, positive=True)
    doppler_average_s: float | None = entry(None, positive=True)
    extra_sigma_m: float = entry(
        0.0,
        not_negative=True,
        advice="it is of all observations; one by type, station or file belongs to [[observations.weights]]",
    )
    tdm: TdmAgreement = entry(
        factory=TdmAgreement,
        keys=tuple(TDM_KEYS),
        read=lambda table, _: table.read(TdmAgreement, TDM_KEYS, finish=False),
    )
    frequencies: tuple[FrequencyAgreement, ...] = ()
    sites: tuple[Path, ...] = ()
    vlbi_station_sigma_m: float | Mapping[str, float] = entry(0.0, not_negative=True)
    vlbi_station_rate_sigma_m: float | Mapping[str, float] = entry(0.0, not_negative=True)
    doppler_phase_sigma_m: float | Mapping[str, float] = entry(0.0, not_negative=True)
    transmitters: tuple[str, ...] | None = entry(None, names=True)
    turnarounds: tuple[str, ...] | None = entry(None, names=True)
    uplinks: tuple[Uplink, ...] = ()
    weights: tuple[Weight, ...] = entry(
        (),
        advice='they are of chosen observations; how series are weighed ("correlated") is in [estimate] weights',
    )
    map_positions: tuple[PlaceOnMap, ...] = ()

    def __post_init__(self) -> None:
        files = (self.files,) if isinstance(self.files, (str, Path)) else self.files
        set_fields(self, files=tuple(Path(file) for file in files))
        for name in ("weights", "frequencies", "map_positions", "uplinks"):
            set_fields(self, **{name: tuple(getattr(self, name))})
        check(self)
        if self.start is not None and self.stop is not None:
            length_s = utc_to_tai(self.stop).seconds_since(utc_to_tai(self.start))
            if not (length_s > 0.0).all():
                raise InputError("stop: expected an epoch after the start")

    def require_transmitters(self) -> None:
        """Raise :class:`InputError` if transmitters or turnaround ratios are given as candidates only."""
        for key in ("transmitters", "turnarounds"):
            if getattr(self, key) is not None:
                raise InputError(
                    f"[observations] {key}: expected one of each pass, [[observations.uplinks]], got candidates; "
                    "`radioloc search STUDY.toml --out completed.toml` finds them"
                )
