"""Make the files of examples/dsn: an orbit data file of a fictitious lander.

    PYTHONPATH=src:tests/support python tests/support/dsn_pass.py [DIR]

Light times at a constant frequency are those of the library. Uplink frequencies, received cycles and bits of
the records are independent, so that the residuals of the example validate the reading of ramps and records.
"""

import sys
from fractions import Fraction
from pathlib import Path

import numpy as np
from arc_cases import observed_at
from odf_files import odf

from radioloc.constants import C_M_S
from radioloc.lunar import LunarPosition
from radioloc.measurements import ExactPredictor, FixedPoint, Link, PhysicalModel
from radioloc.time import epochs_from_strings, utc_to_tai

LANDER = LunarPosition.from_selenographic(31.25, 8.4, -1750.0, "ME_DE421")
"""True position; the study begins a kilometre away."""
SPACECRAFT = 999
DAY = "2020-12-02"
DAY_S = 2238019200  # from 1950, without leap seconds
X_UP_HZ, OSCILLATOR = 7187.5e6, 1.2e-7
"""First uplink frequency, and relative frequency offset of the lander's oscillator."""
COUNT_S, RANGE_STEP_S = 10, 300
LOWEST_COMPONENT = 14
SIGMA_HZ, SIGMA_ONE_WAY_HZ, SIGMA_RANGE_M = 0.0013, 0.0013, 2.0
PASSES = (
    # Station, delays there, ns; beginning and end, s of the day; steps of the reference frequency, Hz.
    (65, 4000, 4100, 10800, 19800, (0.0,)),
    (24, 77000, 77000, 30000, 39000, (0.0, 2500.0)),
)
FILES = ("lander.odf",)


def path_m(model, station, tag_s, one_way):
    """Return the light path at the antenna, m, by seconds of day of reception."""
    start = utc_to_tai(epochs_from_strings([DAY], "UTC"))
    name = f"DSS-{station}"
    plan = observed_at(
        start[np.zeros(len(tag_s), dtype=int)].shifted(tag_s),
        Link("" if one_way else name, "lander", name),
        kind="one_way_range" if one_way else "range",
        value_m=7e8,
        wavelength_um=1e6 * C_M_S / (X_UP_HZ * 880 / 749),
        uplink_hz=np.nan if one_way else X_UP_HZ,
    )
    lander_pa_m = LANDER.to_frame(model.libration.frame).xyz_m
    return ExactPredictor(model, plan, FixedPoint(lander_pa_m)).compute().value_m


class Exciter:
    """Uplink frequency with ramps of ten minutes and whole nanohertz per second."""

    def __init__(self, first_s: int, last_s: int) -> None:
        self.start_s = np.arange(first_s - 1200, last_s + 600, 600)
        self.rate_hz_s = np.round(
            0.7 * np.cos(self.start_s / 4000.0) + 0.05 * np.sin(self.start_s / 700.0), 9
        )
        self.over_hz = np.concatenate([[0.0], np.cumsum(600.0 * self.rate_hz_s)[:-1]])
        cycles = 600.0 * self.over_hz + 0.5 * 600.0**2 * self.rate_hz_s
        self.cycles = np.concatenate([[0.0], np.cumsum(cycles)[:-1]])

    def excess(self, time_s):
        """Return cycles since the first ramp in excess of those of the first frequency."""
        k = np.searchsorted(self.start_s, time_s, side="right") - 1
        since_s = time_s - self.start_s[k]
        return self.cycles[k] + (self.over_hz[k] + 0.5 * self.rate_hz_s[k] * since_s) * since_s

    def records(self, station):
        for k, start_s in enumerate(self.start_s.tolist()):
            yield {
                "station": station,
                "start_s": DAY_S + start_s,
                "stop_s": DAY_S + start_s + 600,
                **split_hz(self.over_hz[k]),
                "rate_hz_s": int(self.rate_hz_s[k]),
                "rate_nhz_s": round((self.rate_hz_s[k] - int(self.rate_hz_s[k])) * 1e9),
            }


def split_hz(over_hz):
    """Return gigahertz, hertz and nanohertz of a frequency, given relative to the first."""
    nanohertz = round(X_UP_HZ) * 10**9 + round(over_hz * 1e9)
    hertz, nano = divmod(nanohertz, 10**9)
    return {"frequency_ghz": hertz // 10**9, "frequency_hz": hertz % 10**9, "frequency_nhz": nano}


def observable(value):
    """Return whole and billionths, both with the sign."""
    integer = int(value)
    return {"observable": integer, "observable_1e9": round((value - integer) * 1e9)}


def reference(hertz):
    millihertz = round(hertz * 1000)
    return {"reference_2e24_mhz": millihertz >> 24, "reference_mhz": millihertz % 2**24}


def records(model, rng):
    """Return orbit data and ramps of all passes."""
    ratio = Fraction(880, 749)
    orbit, ramps = [], []
    for station, up_ns, down_ns, first_s, last_s, steps_hz in PASSES:
        locked_s = first_s + 600
        exciter = Exciter(first_s, last_s)
        ramps += exciter.records(station)
        common = {
            "receiver_delay_ns": down_ns,
            "format": 2,
            "receiver": station,
            "downlink": 2,
            "channel": 5,
            "spacecraft": SPACECRAFT,
            "independent": 1,
        }
        # Beacon with a reference at S band.
        tag_s = np.arange(first_s, locked_s, COUNT_S)
        ends_m = path_m(model, station, end_s(tag_s, down_ns), one_way=True).reshape(2, -1)
        reference_hz = round(X_UP_HZ * float(ratio) * 240 / 880, 3)  # records have millihertz
        carrier_hz = reference_hz * 880 / 240
        received_hz = carrier_hz * (1.0 + OSCILLATOR) * (1.0 - np.diff(ends_m, axis=0)[0] / C_M_S / COUNT_S)
        received_hz += SIGMA_ONE_WAY_HZ * rng.standard_normal(len(tag_s))
        for time_s, hertz in zip(tag_s.tolist(), (carrier_hz - received_hz).tolist(), strict=True):
            orbit.append(
                common
                | {"type": 11, "exciter": 1, "time_s": DAY_S + time_s, "item_21": 100 * COUNT_S}
                | reference(reference_hz)
                | observable(hertz)
            )
        # Two-way, from the cycles at the time of transmission.
        two_way = common | {"transmitter": station, "uplink": 2, "exciter": 2, "transmitter_delay_ns": up_ns}
        tag_s = np.arange(locked_s, last_s, COUNT_S)
        received_s = end_s(tag_s, down_ns)
        way_m = path_m(model, station, received_s, one_way=False)
        sent_s = received_s - way_m / C_M_S - 1e-9 * up_ns
        growth_m = np.diff(way_m.reshape(2, -1), axis=0)[0]
        beyond = np.diff(exciter.excess(sent_s).reshape(2, -1), axis=0)[0]
        noise_hz = SIGMA_HZ * rng.standard_normal(len(tag_s))
        part = len(tag_s) // len(steps_hz) + 1
        for k, time_s in enumerate(tag_s.tolist()):
            reference_hz = X_UP_HZ + steps_hz[k // part]
            # Reference less received frequency, from differences: times of day are rounded to a millimetre of light.
            short_hz = X_UP_HZ * growth_m[k] / C_M_S / COUNT_S + steps_hz[k // part] - beyond[k] / COUNT_S
            orbit.append(
                two_way
                | {"type": 12, "time_s": DAY_S + time_s, "item_21": 100 * COUNT_S}
                | reference(reference_hz)
                | observable(float(ratio) * short_hz + noise_hz[k])
            )
        tag_s = np.arange(locked_s, last_s, RANGE_STEP_S)
        antenna_s = tag_s - 1e-9 * down_ns
        way_m = path_m(model, station, antenna_s, one_way=False)
        sent_s = antenna_s - way_m / C_M_S - 1e-9 * up_ns
        cycles = X_UP_HZ * way_m / C_M_S + exciter.excess(antenna_s - 1e-9 * up_ns) - exciter.excess(sent_s)
        cycles += X_UP_HZ / C_M_S * SIGMA_RANGE_M * rng.standard_normal(len(tag_s))
        units = (cycles * 221 / (2 * 749)) % 2.0 ** (LOWEST_COMPONENT + 6)
        for time_s, value in zip(tag_s.tolist(), units.tolist(), strict=True):
            orbit.append(
                two_way
                | {"type": 37, "channel": LOWEST_COMPONENT, "time_s": DAY_S + time_s}
                | reference(X_UP_HZ)
                | observable(value)
            )
    orbit.sort(key=lambda row: row["time_s"])
    return orbit, ramps


def end_s(tag_s, down_ns):
    """Return starts and ends of counts at the antenna."""
    return np.concatenate([tag_s - 0.5 * COUNT_S, tag_s + 0.5 * COUNT_S]) - 1e-9 * down_ns


def main(folder: Path) -> None:
    """Write the file."""
    orbit, ramps = records(PhysicalModel.build(), np.random.default_rng(1))
    (folder / FILES[0]).write_bytes(odf(orbit, ramps, label=(SPACECRAFT, 1201203, 0, 19500101, 0)))


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parents[2] / "examples" / "dsn")
