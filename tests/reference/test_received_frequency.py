"""Received frequencies at X band against an integration of the received wave in 40 digits.

The library takes a mean frequency for a difference of phases, and that for a difference of light times. Here the
received frequency of each instant is made of the light time and its rate (what was sent a light time before, times the
transponder's ratio, times 1 less that rate) and integrated over the count interval by quadrature. The light time is
that of a station on the turning Earth and a lander on the Moon, in closed form.
"""

from functools import cache

import mpmath as mp
import numpy as np
import pytest
from tdm_messages import THREE_WAY, TWO_WAY, growth_m, kvn, xml

from radioloc.constants import C_M_S
from radioloc.io.tdm import TdmAgreement, tdm_observations
from radioloc.io.tdm.kvn import parse_kvn, parse_xml

# 1e-12 of the frequency is 0.3 mm/s, 18 mm in 60 s; what is reached is the digits of the numbers in the message.
RELATIVE = 1e-12
REACHED_M = 2e-6

UP, DOWN = 880, 749
COUNT_S = 60.0
OFFSET_HZ = 8.4e9
STARTS_S = tuple(COUNT_S * k for k in range(8))
START = "2020-12-01T15:11:00"
BREAKS_S = (-10.0, 95.0, 210.5, 333.0)  # not where the count intervals begin or end
RATES_HZ_S = (1.25, -2.5, 0.375, 3.0)
BASE_HZ = 7.1625e9

STATION_S, TURN_S = mp.mpf("0.0274"), mp.mpf("7.292115e-5")  # twice 4100 km off the axis; rad/s
MOON_S, MONTH_S = mp.mpf("0.14"), mp.mpf("2.6617e-6")


def light_s(t):
    """Light time up and down, s, at reception t s after the start."""
    station = STATION_S * mp.cos(TURN_S * t + mp.mpf("0.9"))
    return mp.mpf("2.58") - station - MOON_S * mp.cos(MONTH_S * t - mp.mpf("0.3"))


def light_rate(t):
    """Derivative of the light time."""
    station = STATION_S * TURN_S * mp.sin(TURN_S * t + mp.mpf("0.9"))
    return station + MOON_S * MONTH_S * mp.sin(MONTH_S * t - mp.mpf("0.3"))


def sent_hz(t, ramped):
    if not ramped:
        return mp.mpf(BASE_HZ)
    frequency = mp.mpf(BASE_HZ)
    for k, (since, rate) in enumerate(zip(BREAKS_S, RATES_HZ_S, strict=True)):
        until = BREAKS_S[k + 1] if k + 1 < len(BREAKS_S) else mp.inf
        if t <= until:
            return frequency + rate * (t - since)
        frequency += rate * (until - since)
    raise AssertionError


def mean_received_hz(start_s, ramped):
    """Integral of the received frequency over the count interval, over its length."""

    def received(t):
        return mp.mpf(UP) / DOWN * sent_hz(t - light_s(t), ramped) * (1 - light_rate(t))

    ends = [start_s, start_s + COUNT_S]
    # The received wave has kinks where the kinks of the sent one arrive.
    for kink in BREAKS_S[1:] if ramped else ():
        arrival = mp.findroot(lambda t, kink=kink: t - light_s(t) - kink, kink + 2.6)
        if ends[0] < arrival < ends[-1]:
            ends.insert(1, arrival)
    return mp.quad(received, sorted(ends)) / COUNT_S


@cache
def mean_received(ramped):
    with mp.workdps(40):
        return [mean_received_hz(start, ramped) for start in STARTS_S]


def tracking_message(metadata, ramped):
    """Message of eight count intervals, and by how much the path grows in each."""
    receiver = metadata["PATH"][-1]
    records = []
    with mp.workdps(40):
        for k, mean_hz in enumerate(mean_received(ramped)):
            value = mp.nstr(mean_hz - OFFSET_HZ, 20)
            records.append(f"RECEIVE_FREQ_{receiver} = 2020-12-01T15:{11 + k}:30 {value}")
        grown_m = [float(C_M_S * (light_s(s + COUNT_S) - light_s(s))) for s in STARTS_S]
        if not ramped:  # known for long enough that all counts were sent under it, whatever the light time
            records.append(f"TRANSMIT_FREQ_1 = 2020-12-01T14:00:00 {mp.nstr(sent_hz(mp.mpf(0), False), 17)}")
        for since, rate in zip(BREAKS_S, RATES_HZ_S, strict=True) if ramped else ():
            minute, second = divmod(660.0 + since, 60.0)
            date = f"2020-12-01T15:{int(minute):02d}:{second:06.3f}"
            records.append(f"TRANSMIT_FREQ_1 = {date} {mp.nstr(sent_hz(mp.mpf(since), ramped), 17)}")
            records.append(f"TRANSMIT_FREQ_RATE_1 = {date} {rate}")
    metadata_keys = {
        "TURNAROUND_NUMERATOR": UP,
        "TURNAROUND_DENOMINATOR": DOWN,
        "INTEGRATION_INTERVAL": COUNT_S,
        "INTEGRATION_REF": "MIDDLE",
        "FREQ_OFFSET": OFFSET_HZ,
        "TRANSMIT_BAND": "X",
        "RECEIVE_BAND": "X",
    }
    return (metadata | metadata_keys, records), np.array(grown_m)


def sent_s(received_s):
    """Return the time of emission of a signal by its time of arrival, s after the start."""
    return float(received_s - light_s(mp.mpf(received_s)))


@pytest.mark.parametrize("form", ["kvn", "xml"])
@pytest.mark.parametrize("metadata", [TWO_WAY, THREE_WAY], ids=["two-way", "three-way"])
@pytest.mark.parametrize("ramped", [False, True], ids=["constant", "ramped"])
def test_growth_of_the_path(ramped, metadata, form):
    segment, grown_m = tracking_message(metadata, ramped)
    message = parse_kvn("a.kvn", kvn(segment)) if form == "kvn" else parse_xml("a.xml", xml(segment))
    got = tdm_observations(message, TdmAgreement(sigma_m={"doppler": 1e-3})).observations
    assert got.types().tolist() == ["doppler"] * 8
    assert set(got.count_s) == {COUNT_S}
    assert np.abs(grown_m).max() > 1e3  # there is something to find
    assert set(got.ramped) == {ramped}
    assert len(got.ramps) == len(BREAKS_S) * ramped
    got_m = got.value_m
    if ramped:
        assert np.abs(got_m - grown_m).max() > 100.0  # cycles of a ramp are no length
        got_m = growth_m(
            got, START, *([sent_s(s + offset_s) for s in STARTS_S] for offset_s in (0.0, COUNT_S))
        )
    left_m = np.abs(got_m - grown_m)
    assert left_m.max() < REACHED_M
    assert left_m.max() / (C_M_S * COUNT_S) < RELATIVE
