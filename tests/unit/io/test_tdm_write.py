"""Written messages read back identically, also by ccsds-ndm; observations without a keyword are refused."""

from decimal import Decimal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tdm_messages import TWO_WAY, kvn

from radioloc.constants import C_M_S
from radioloc.errors import InputError
from radioloc.io.tdm import TdmAgreement, read_tdm, read_tdm_file
from radioloc.io.tdm.kvn import parse_kvn
from radioloc.io.tdm.message import DATA, METADATA, TYPES, unit_exponent
from radioloc.io.tdm.write import write_tdm
from radioloc.measurements.link import Link
from radioloc.measurements.observations import DOPPLER, RANGE, VLBI_DELAY, VLBI_DELAY_RATE, Observations
from radioloc.measurements.registry import kind_of
from radioloc.time import Epochs

AGREEMENT = TdmAgreement(sigma_m=dict.fromkeys(TYPES, 1.0))
COLUMNS = (
    "tag",
    "kind",
    "value_m",
    "pressure_hpa",
    "temperature_k",
    "relative_humidity",
    "wavelength_um",
    "uplink_hz",
    "count_s",
)
LINKS = (
    Link("KASHI", "lander", "KASHI"),
    Link("KASHI", "lander", "JIAMUSI"),
    Link("SESHAN25", "lander", "KUNMING", True),
    Link("", "lander", "KASHI"),
)
ONE_WAY_RANGE, ONE_WAY_DOPPLER = kind_of("one_way_range"), kind_of("one_way_doppler")
DIFFERENCED_RANGE, DIFFERENCED_DOPPLER = kind_of("differenced_range"), kind_of("differenced_doppler")


def rows_of(observations):
    """Return rows as tuples that can be sorted and compared, NaN as None."""
    columns = [
        observations.paths().tolist(),
        observations.epoch.jd.tolist(),
        observations.epoch.fraction.tolist(),
    ]
    columns += [getattr(observations, name).tolist() for name in COLUMNS]
    rows = [tuple("none" if value != value else value for value in row) for row in zip(*columns, strict=True)]
    return sorted(rows, key=repr)


def written_and_read(observations, path, **options):
    write_tdm(path, observations, originator="TEST", **options)
    return read_tdm(path, AGREEMENT)


def observations_with(n=6, **columns):
    """Return ranges a second apart, with other columns if given."""
    defaults = {
        "epoch": Epochs.from_jd(np.full(n, 2459301.5), 0.5 + np.arange(n) / 86400.0, "UTC"),
        "links": LINKS,
        "value_m": 7.688e8 + np.arange(n) / 3.0,
        "sigma_m": 1.0,
        "tag": 1,
    }
    return Observations.from_columns(**(defaults | columns))


def everything():
    """Return all kinds, with and without recorded conditions; two of one kind, link and epoch."""
    n = 48
    random = np.random.default_rng(5)
    kinds = [RANGE, RANGE, DOPPLER, VLBI_DELAY, ONE_WAY_RANGE, ONE_WAY_DOPPLER]
    kind = np.repeat([*kinds, DIFFERENCED_RANGE, DIFFERENCED_DOPPLER], n // 8)
    link = np.repeat([0, 1, 1, 2, 3, 3, 2, 2], n // 8)
    counted = np.isin(kind, [DOPPLER, ONE_WAY_DOPPLER, DIFFERENCED_DOPPLER])
    value = np.select(
        [kind == RANGE, np.isin(kind, [VLBI_DELAY, DIFFERENCED_RANGE]), kind == ONE_WAY_RANGE],
        [7.6e8 + 1e7 * random.random(n), random.normal(0.0, 3e6, n), 3.8e8 + 1e7 * random.random(n)],
        random.normal(0.0, 3e4, n),
    )
    # Delays of seconds and range differences of rates, which a file represents exactly.
    value = np.where(kind == VLBI_DELAY, C_M_S * (value / C_M_S), value)
    value = np.where(counted, 60.0 * (value / 60.0), value)
    half = np.arange(n) % 2 == 0
    fraction = 0.5 + (np.arange(n) % 6) * np.pi * 1e-4
    fraction[4] = fraction[2]
    return observations_with(
        n,
        epoch=Epochs.from_jd(np.full(n, 2459301.5), fraction, "UTC"),
        kind=kind,
        link=link,
        value_m=value,
        tag=np.where((kind == RANGE) & (link == 0), 0, 1),
        count_s=np.where(counted, 60.0, np.nan),
        uplink_hz=np.where(half & (link < 2), 7.2e9 + random.random(n), np.nan),
        wavelength_um=np.where(half, 35500.0 + random.random(n), np.nan),
        pressure_hpa=np.where(kind == RANGE, 870.0 + random.random(n), np.nan),
        temperature_k=np.where(half, 280.0 + random.random(n), np.nan),
        relative_humidity=np.where(link == 1, random.random(n), np.nan),
    )


def test_all_columns_are_restored_to_the_last_bit(tmp_path):
    observations = everything()
    assert rows_of(written_and_read(observations, tmp_path / "a.kvn")) == rows_of(observations)


@given(
    values=st.lists(st.floats(6.6e8, 8.3e8), min_size=1, max_size=20),
    second=st.integers(0, 86399),
    picosecond=st.integers(0, 10**12 - 1),
)
def test_ranges_are_restored_to_the_last_bit(tmp_path, values, second, picosecond):
    n = len(values)
    fraction = (second + picosecond * 1e-12) / 86400.0 + np.arange(n) * 1e-9
    observations = observations_with(
        n, value_m=values, epoch=Epochs.from_jd(np.full(n, 2459301.5), fraction, "UTC")
    )
    read = written_and_read(observations, tmp_path / "a.kvn")
    assert read.value_m.tolist() == values
    seconds = (read.epoch.fraction - observations.epoch.fraction) * 86400.0
    assert np.abs(seconds).max() <= 1.2e-11  # a float of the day's fraction, which the decimals round to
    assert rows_of(written_and_read(read, tmp_path / "b.kvn")) == rows_of(read)


def test_leap_second_and_decimals(tmp_path):
    expected = parse_kvn("a", kvn((TWO_WAY, ["RANGE = 2016-12-31T23:59:60.123456789012 768800.0"]))).segments[
        0
    ]
    observations = observations_with(1, epoch=expected.epoch)
    read = written_and_read(observations, tmp_path / "a.kvn")
    assert "T23:59:60.12345678901" in (tmp_path / "a.kvn").read_text()
    assert read.epoch.fraction[0] == expected.epoch.fraction[0]


def test_metadata_in_the_order_of_the_standard(tmp_path):
    write_tdm(tmp_path / "a.kvn", everything(), originator="TEST", comments=["first\nsecond"])
    lines = (tmp_path / "a.kvn").read_text().split("\n")
    assert lines[:3] == ["CCSDS_TDM_VERS = 2.0", "COMMENT first", "COMMENT second"]
    metadata = [line.partition(" =")[0] for line in lines[6 : lines.index("META_STOP")]]
    assert metadata == sorted(metadata, key=list(METADATA).index)


@pytest.mark.parametrize(
    ("columns", "problem"),
    [
        ({"tag": 2}, "bounce"),
        ({"kind": ONE_WAY_RANGE, "link": 3, "uplink_hz": 7e9}, "one_way_range with an uplink"),
        ({"kind": VLBI_DELAY_RATE, "link": 2, "value_m": 1.0, "count_s": 10.0}, "vlbi_delay_rate"),
        ({"links": (Link("Fürth", "lander", "Fürth"),)}, "Fürth"),
    ],
)
def test_observations_without_a_keyword_are_refused(columns, problem, tmp_path):
    with pytest.raises(InputError, match=problem):
        write_tdm(tmp_path / "a.kvn", observations_with(**columns), originator="TEST")
    assert not (tmp_path / "a.kvn").exists()


@pytest.mark.parametrize(
    ("options", "problem"),
    [
        ({"originator": " "}, "ORIGINATOR"),
        ({"originator": "a\nb"}, "printable ASCII"),
        ({"comments": ["\t"]}, "printable ASCII"),
    ],
)
def test_header_texts_are_printable_ascii(options, problem, tmp_path):
    with pytest.raises(InputError, match=problem):
        write_tdm(tmp_path / "a.kvn", observations_with(), **({"originator": "TEST"} | options))


# Another implementation of the standard


def test_ccsds_ndm_reads_the_same(tmp_path):
    ndm_io = pytest.importorskip("ccsds_ndm.ndm_io")
    observations = everything()
    path = tmp_path / "a.kvn"
    write_tdm(path, observations, originator="TEST", comments=["a comment"])
    reference = ndm_io.NdmIo().from_path(path)
    ours = read_tdm_file(path)
    assert len(reference.body.segment) == len(ours.segments)
    for segment, theirs in zip(ours.segments, reference.body.segment, strict=True):
        assert theirs.metadata.participant_1 == segment.metadata["PARTICIPANT_1"]
        values = []
        for record in theirs.data.observation:
            held = {
                name: value for name, value in vars(record).items() if value is not None and name != "epoch"
            }
            ((name, value),) = held.items()
            values.append((name.upper().removeprefix("VALUE_"), float(getattr(value, "value", value))))
        keywords = [DATA[code] for code in segment.keyword]
        decimals = [
            Decimal(repr(value)).scaleb(-unit_exponent(k, "km"))
            for k, value in zip(keywords, segment.value.tolist(), strict=True)
        ]
        assert values == list(zip(keywords, map(float, decimals), strict=True))


@pytest.mark.parametrize("suffix", ["kvn", "xml"])
def test_messages_of_ccsds_ndm_are_read(suffix, tmp_path):
    ndm_io = pytest.importorskip("ccsds_ndm.ndm_io")
    observations = everything()
    first, second = tmp_path / "a.kvn", tmp_path / f"b.{suffix}"
    write_tdm(first, observations, originator="TEST")
    formats = ndm_io.NDMFileFormats
    kind = formats.XML if suffix == "xml" else formats.KVN
    ndm_io.NdmIo().to_file(ndm_io.NdmIo().from_path(first), kind, second)
    ours, theirs = read_tdm(first, AGREEMENT), read_tdm(second, AGREEMENT)
    for name in COLUMNS:
        # That library stores kilometres and percent as floats, which rounds twice.
        np.testing.assert_allclose(getattr(theirs, name), getattr(ours, name), rtol=3e-16, atol=0.0)
    assert theirs.paths().tolist() == ours.paths().tolist()
    assert theirs.epoch.fraction.tolist() == ours.epoch.fraction.tolist()
