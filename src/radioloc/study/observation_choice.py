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
    """Choice of the observations of a study.

    Parameters
    ----------
    files : path-like or iterable of path-like
        Files to read, globs already resolved.
    targets, stations : str or iterable of str, or None
        Targets and stations to keep; all where ``None``.
    target_names : mapping of str to str
        Names that targets have in the study, by those in the files.
    types : str or iterable of str, or None
        Types of measurement to keep, such as ``"doppler"``; all where ``None``.
    start, stop : Epochs or None
        First and last epoch to keep, UTC.
    hours : float or None
        Length of the arc from ``start``, or from the first observation.
    doppler_average_s : float or None
        Counts of integrated Doppler and delay rates that follow each other without gaps, of one path and frequency, are
        summed over this interval, s.
    extra_sigma_m : float
        Error of the model and of the instruments beyond the stated sigmas, added in quadrature to each stated
        sigma, m; of ranges and Doppler that of the round trip.
    tdm : TdmAgreement
        Agreements on Tracking Data Messages: sigmas, whether RANGE is halved, ...
    frequencies : iterable of FrequencyAgreement
        Signals of the files of received frequencies: for each file the first entry that matches it.
    sites : tuple of Path
        Files of sites (:func:`~radioloc.io.read_sites`), whose stations a study file has beside those of the catalogue.
    vlbi_station_sigma_m : float or mapping of str to float
        Error of each VLBI station's arrival time, metres, which all delays of one epoch that the station has part in
        share; beside the sigmas of the delays. By station: those not named have none.
    vlbi_station_rate_sigma_m : float or mapping of str to float
        Likewise the error of by how much each station's arrival time grows over the count interval, for delay rates.
    doppler_phase_sigma_m : float or mapping of str to float
        White noise of the phase at either end of a count of one-, two- or three-way Doppler, metres, by receiving
        station or of all, beside the sigmas of the counts: contiguous counts of a link share that between them, with
        opposite signs.
    transmitters : str or iterable of str, or None
        Candidates for the transmitter of Doppler: ``radioloc search`` states for each pass the one that leaves the
        smallest residuals, whatever the files name.
    turnarounds : str or iterable of str, or None
        Candidates for the ratio of frequency down to up, such as ``"880/749"``.
    uplinks : iterable of Uplink
        Transmitters and turnaround ratios of passes, in place of those of the files.
    weights : iterable of Weight
        Changes of the stated sigmas by type, station and file, before the extra ones are added.
    map_positions : iterable of PlaceOnMap
        Where targets are seen on maps. The ties of the maps are considered, with independent weights estimated about
        zero, with their sigmas, unless the study says otherwise.
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
