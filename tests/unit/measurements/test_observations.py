"""Table of observations: validation, selection, concatenation and duplicates."""

import numpy as np
import pytest

from radioloc.errors import DataQualityWarning, FileFormatError, InputError
from radioloc.measurements import Geometry, MeasurementType
from radioloc.measurements.link import Link, canonical_target
from radioloc.measurements.observations import Observations, without_duplicates
from radioloc.measurements.registry import is_differenced, is_integrated
from radioloc.time import Epochs

LINKS = (Link("APOLLO", "apollo15", "APOLLO"), Link("GRASSE", "apollo11", "GRASSE"))


def make(n=4, **changes):
    columns = {
        "epoch": Epochs.from_jd(2460000.5 + np.arange(n), 0.25, "UTC"),
        "links": LINKS,
        "link": np.arange(n) % 2,
        "value_m": 7.7e8 + 1.234567 * np.arange(n),
        "sigma_m": 0.01,
        "pressure_hpa": 720.0,
        "temperature_k": 280.0,
        "relative_humidity": 0.3,
        "wavelength_um": 0.532,
        "files": ("a.npt",),
        "line": 10 + np.arange(n),
    }
    return Observations.from_columns(**(columns | changes))


KASHI = (Link("KASHI", "lander", "KASHI"), Link("KASHI", "lander", "JIAMUSI"))


def series(seconds, value_m=None, files=("a.csv",), file=0, **changes):
    """Return ranges of a lander at seconds of a day, with different values."""
    seconds = np.asarray(seconds)
    values = 7.8e8 + 0.37 * np.arange(len(seconds)) if value_m is None else value_m
    columns = {"epoch": Epochs.from_jd(2459184.5, seconds / 86400.0, "UTC"), "links": KASHI, "link": 0}
    columns |= {"value_m": values, "sigma_m": 1.0, "files": files, "file": file}
    return Observations.from_columns(**(columns | changes))


ODD_S = 54660.1234567 + 60.0 * np.arange(20)
VALUE_M = 7.8e8 + 1e3 * np.sin(np.arange(20.0))


@pytest.mark.parametrize(
    ("copies_s", "rounding_m", "files"),
    [
        (ODD_S, 0.0, False),
        (ODD_S + 1e-6, 0.0, False),
        (ODD_S - 7e-6, 0.0, True),
        (ODD_S.round(6), 1e-4, True),  # a file with microseconds and tenths of a millimetre
        (ODD_S.round(4), 1e-3, True),
        (ODD_S.round(3), 1e-2, True),
        (ODD_S.round(3), 0.0, False),
        (np.floor(1e3 * ODD_S) / 1e3, 0.0, True),  # truncated
        (ODD_S + 1e-3, 0.0, False),
    ],
)
def test_copies_are_removed_also_with_rounded_times_and_values(copies_s, rounding_m, files):
    values = VALUE_M if not rounding_m else rounding_m * np.rint(VALUE_M / rounding_m)
    table = series(
        np.concatenate([ODD_S, copies_s]),
        np.concatenate([VALUE_M, values]),
        files=("a.csv", "b.tdm"),
        file=np.repeat([0, int(files)], 20),
        wavelength_um=np.repeat([35394.6, np.nan if files else 35394.6], 20),
    )
    with pytest.warns(DataQualityWarning, match=r"21:.*a.csv.*1.*20"):
        unique = without_duplicates(table)
    assert unique.value_m.tolist() == VALUE_M.tolist()
    interleaved = table.select(np.arange(40).reshape(2, 20).T.ravel())
    with pytest.warns(DataQualityWarning, match="20 such"):
        assert len(without_duplicates(interleaved)) == 20


def test_another_value_a_microsecond_later_is_an_error():
    table = series(np.concatenate([ODD_S, ODD_S[:1] + 1e-6]), np.append(VALUE_M, VALUE_M[0] + 2.0))
    with pytest.raises(InputError, match=r"21:.*line 1 \(1"):
        without_duplicates(table)


@pytest.mark.parametrize(
    "dense",
    [
        series(np.arange(500.0)),
        series(1e-3 * np.arange(500)),
        series(np.repeat(np.arange(50.0), 2), link=np.tile([0, 1], 50), value_m=7.8e8),
        series(np.repeat(ODD_S, 3), wavelength_um=np.tile([0.532, 1.064, 2.0], 20)),
        series(ODD_S[0] + 8.64e-5 * np.arange(20), value_m=6.6e8),  # equal values by chance
        series(np.arange(50.0), value_m=300.0, kind="doppler", tag="receive", count_s=1.0),
        series(1e-5 * np.arange(9), value_m=1e-3, kind="doppler", tag="receive", count_s=1e-5),
        series(
            np.repeat(ODD_S, 2), value_m=300.0, kind="doppler", tag="receive", count_s=np.tile([1, 60], 20)
        ),
    ],
    ids=["1 Hz", "1 kHz", "links", "wavelengths", "values", "counts", "short counts", "intervals"],
)
def test_dense_series_have_no_copies(dense):
    assert without_duplicates(dense) is dense


def test_arrays_are_read_only_copies():
    values = np.full(4, 7.7e8)
    table = make(value_m=values)
    values[0] = 1.0
    assert table.value_m[0] == 7.7e8
    for array in (table.value_m, table.link, table.epoch.jd, table.select([0, 1]).sigma_m):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0


@pytest.mark.parametrize(
    ("changes", "line", "words"),
    [
        ({"value_m": [7e8, np.nan, 7e8, 7e8]}, 11, "observed_m: .* got nan"),
        ({"sigma_m": [1.0, 1.0, 1.0, 0.0]}, 13, "sigma_m: .* got 0"),
        ({"temperature_k": 20.0}, 10, "temperature_k: .* got 20"),
        ({"pressure_hpa": 101325.0}, 10, "100 to 1100"),
        ({"wavelength_um": 35.4, "uplink_hz": 7.2e9}, 10, "0.05 to 20 times"),
    ],
)
def test_impossible_values_name_file_and_line(changes, line, words):
    with pytest.raises(FileFormatError, match=words) as caught:
        make(**changes)
    assert caught.value.line == line
    assert caught.value.path.name == "a.npt"


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"value_m": [1.0, 2.0]}, "one value or 4"),
        ({"tag": -1}, "tag: expected indices"),
        ({"epoch": Epochs.from_jd(np.full(4, 2460000.5), 0.0, "TT")}, "UTC"),
    ],
)
def test_unusable_columns(changes, words):
    with pytest.raises(InputError, match=words):
        make(**changes)


def test_select_and_concatenate():
    first, second = make(), make(files=("b.npt",), links=LINKS[::-1])
    joined = Observations.concatenate([first, second])
    assert joined.links == LINKS
    assert joined.files == ("a.npt", "b.npt")
    assert joined.paths().tolist() == first.paths().tolist() + second.paths().tolist()
    assert joined.origin(5) == "b.npt, line 11"
    back = joined.select(joined.file == 1)
    assert back.paths().tolist() == second.paths().tolist()
    assert back.value_m.tolist() == second.value_m.tolist()
    assert joined.select(slice(None, None, -1)).line.tolist() == joined.line.tolist()[::-1]
    assert len(joined.select(np.zeros(8, dtype=bool))) == 0
    assert len(joined.select(3)) == 1
    with pytest.raises(InputError, match="one or more"):
        Observations.concatenate([])


def test_span_does_not_depend_on_the_order():
    epoch = Epochs.from_jd(2460000.5 + np.array([1.0, 0.0, 1.0, 0.0]), np.array([0.9, 0.3, 0.1, 0.2]), "UTC")
    table = make(epoch=epoch)
    assert (table.span().jd.tolist(), table.span().fraction.tolist()) == ([2460000.5, 2460001.5], [0.2, 0.9])


def test_place_and_reception_signs_of_links():
    assert Link.from_path("KASHI>lander>JIAMUSI").place == "JIAMUSI"
    assert Link.from_path("KASHI<lander>JIAMUSI").place == "KASHI\N{EN DASH}JIAMUSI"
    assert Link.from_path("KASHI>lander>JIAMUSI").reception_signs == {"KASHI": 0.0, "JIAMUSI": 1.0}
    assert Link.from_path("KASHI<lander>JIAMUSI").reception_signs == {"KASHI": -1.0, "JIAMUSI": 1.0}


def test_names_of_links_have_a_maximum_length():
    with pytest.raises(InputError, match="up to 80 characters"):
        Link("KASHI", "x" * 81, "KASHI")


def test_summary_counts_by_path_and_type():
    lines = make(5).summary().splitlines()
    assert lines[0] == "5 observations, 2023-02-25T06:00:00 to 2023-03-01T06:00:00 UTC, 1 file(s)"
    assert [line.split() for line in lines[1:]] == [
        ["APOLLO>apollo15>APOLLO", "range", "3"],
        ["GRASSE>apollo11>GRASSE", "range", "2"],
    ]


def test_link_path_round_trip():
    assert Link.from_path(" A > b > C ") == Link("A", "b", "C")
    assert Link.from_path(LINKS[0].path) == LINKS[0]
    for path in ("lander>C", "A<lander>C", "A<rover|lander>C"):
        link = Link.from_path(path)
        assert link.path == path
        assert (
            Link(link.transmitter, link.target, link.receiver, link.differenced, link.second_target) == link
        )
    assert Link.from_path("lander>C").stations == ("C",)
    assert Link.from_path("A<rover|lander>C").targets == ("rover", "lander")
    for bad in ("A", "A>b|c>D", "|b>C", "<b>C", "A<b|>C", "A>b>C>d", "A>>C", "", "A>b,c>D"):
        with pytest.raises(InputError, match=r"name: expected|path: expected|stations"):
            Link.from_path(bad)


@pytest.mark.parametrize(
    ("alias", "name"),
    [("AP15", "apollo15"), ("APOLLO_14", "apollo14"), ("Lunokhod-2", "luna21"), (" Chang'e-4 ", "chang'e-4")],
)
def test_canonical_target(alias, name):
    assert canonical_target(alias) == name


RATE = {
    "kind": "vlbi_delay_rate",
    "links": [Link("SESHAN25", "lander", "URUMQI", True)],
    "link": 0,
    "tag": "receive",
    "value_m": -3000.0,
    "count_s": 60.0,
}


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"count_s": np.nan}, "count interval above zero"),
        ({"count_s": 0.0}, "count interval above zero"),
        ({"tag": "transmit"}, "receive for vlbi_delay_rate"),
        ({"links": [Link("SESHAN25", "lander", "URUMQI")]}, "station1<target>station2"),
        ({"value_m": 60001.0}, "1000 m in a second"),
        ({"kind": "vlbi_delay", "value_m": -1.29e7, "count_s": np.nan}, "below the Earth"),
    ],
)
def test_limits_of_delay_rates(changes, words):
    rate = make(**RATE)
    assert rate.types()[0] == "vlbi_delay_rate"
    assert is_integrated(rate.kind).all()
    assert is_differenced(rate.kind).all()
    with pytest.raises(InputError, match=words):
        make(**(RATE | changes))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"geometry": Geometry.COMBINED}, "if and only if"),
        ({"name": "half range"}, "'half range'"),
        ({"tags": ("receive", "noon")}, "transmit, receive, bounce"),
    ],
)
def test_inconsistent_types(changes, words):
    arguments = {"name": "half_range", "description": "a value", "geometry": Geometry.ROUND_TRIP}
    with pytest.raises(InputError, match=words):
        MeasurementType(**(arguments | changes))
