"""Make this example's files: a lander's beacon as three dishes heard it in four nights, as such files have it.

    python examples/beacon/simulate.py [DIR]

Nobody heard this beacon: its Doppler is computed by the library itself. Added is what spoils such data: a beacon that
is not quite at its frequency and wanders, a receiver with an offset of its own in each pass, and the noise of reading a
peak off a spectrum.
"""

from __future__ import annotations

import sys
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np

import radioloc
from radioloc.constants import C_M_S
from radioloc.io import read_sites
from radioloc.measurements import ExactPredictor, FixedPoint, Link, Observations, PhysicalModel
from radioloc.time import epochs_from_strings, utc_strings

HERE = Path(__file__).resolve().parent
BEACON_HZ, COUNT_S, STEP_S, DAYS = 8450.0e6, 10.0, 600.0, 4
START = datetime(2020, 12, 1)
TRUE = radioloc.LunarPosition.from_selenographic(-30.0, 15.0, -1500.0, "ME_DE421")
LOWEST_DEG = 12.0
READING_HZ = 0.5  # of a peak in a spectrum of 10 s
# The beacon is 1.7 kHz off and wanders by 0.5 Hz within an hour, for all who listen; a receiver by its own standard.
BEACON_OFF_HZ, WANDER_HZ, WANDER_S = -1731.0, 0.5, 3600.0
RECEIVER = 2e-10
FILES = {"COSPAR 9001": "dwingeloo.tdm", "COSPAR 9002": "bochum.dat", "COSPAR 9003": "hat_creek.dat"}
MESSAGE = """\
CCSDS_TDM_VERS = 2.0
COMMENT simulated: peaks of spectra of 10 s
CREATION_DATE = 2020-12-05Z
ORIGINATOR = RADIOLOC EXAMPLE

META_START
TIME_SYSTEM = UTC
PARTICIPANT_1 = COSPAR 9001
PARTICIPANT_2 = beacon
MODE = SEQUENTIAL
PATH = 2,1
INTEGRATION_INTERVAL = 10
INTEGRATION_REF = MIDDLE
FREQ_OFFSET = 0
DATA_QUALITY = RAW
META_STOP

DATA_START
"""


def received() -> tuple[Observations, np.ndarray]:
    """All counts in which the lander stands high enough, and their received frequencies, Hz."""
    catalogue = radioloc.StationCatalogue.default()
    for site in read_sites(HERE / "sites.txt"):
        catalogue = catalogue.with_station(site)
    model = PhysicalModel.build(catalogue=catalogue)
    place_m = TRUE.to_frame("PA_DE421").xyz_m
    after_s = STEP_S * np.arange(DAYS * 86400.0 / STEP_S)
    epoch = epochs_from_strings([(START + timedelta(seconds=s)).isoformat() for s in after_s.tolist()], "UTC")
    random = np.random.default_rng(20201201)
    keep = np.exp(-STEP_S / WANDER_S)
    wander_hz = np.zeros(len(after_s))
    for k in range(1, len(after_s)):
        wander_hz[k] = keep * wander_hz[k - 1] + np.sqrt(1.0 - keep**2) * random.normal(0.0, WANDER_HZ)
    parts, frequencies_hz = [], []
    for name in FILES:
        counts = Observations.from_columns(
            epoch=epoch,
            links=[Link("", "beacon", name)],
            kind="one_way_doppler",
            tag="receive",
            value_m=0.0,
            sigma_m=1.0,
            count_s=COUNT_S,
            wavelength_um=1e6 * C_M_S / BEACON_HZ,
        )
        computed = ExactPredictor(model, counts, FixedPoint(place_m)).compute()
        seen = computed.elevation_rad.min(axis=-1) > np.radians(LOWEST_DEG)
        passes = np.cumsum(np.diff(seen.astype(int), prepend=0) == 1)
        own_hz = BEACON_HZ * random.normal(0.0, RECEIVER, passes.max() + 1)[passes]
        sent_hz = BEACON_HZ + BEACON_OFF_HZ + wander_hz
        received_hz = sent_hz * (1.0 - computed.value_m / (C_M_S * COUNT_S)) + own_hz
        received_hz = received_hz + random.normal(0.0, READING_HZ, len(epoch))
        parts.append(counts.select(seen))
        frequencies_hz.append(received_hz[seen])
    return Observations.concatenate(parts), np.concatenate(frequencies_hz)


def write(folder: Path) -> None:
    """The files of the three dishes."""
    counts, frequencies_hz = received()
    for name, file in FILES.items():
        rows = np.flatnonzero(counts.paths() == f"beacon>{name}")
        epoch, hz = counts.epoch[rows], frequencies_hz[rows].tolist()
        if file.endswith(".tdm"):
            dates = utc_strings(epoch, 3).tolist()
            records = [f"RECEIVE_FREQ_1 = {date} {f:.3f}\n" for date, f in zip(dates, hz, strict=True)]
            text = MESSAGE + "".join(records) + "DATA_STOP\n"
        else:
            mjd = (epoch.jd - 2400000.5) + epoch.fraction
            site = name.removeprefix("COSPAR ")
            text = "".join(
                f"{day:.6f}\t{f:14.3f}\t{10.0:8.3f}\t{site}\n" for day, f in zip(mjd, hz, strict=True)
            )
        (folder / file).write_text(text)


if __name__ == "__main__":
    write(Path(sys.argv[1]) if len(sys.argv) > 1 else HERE)
