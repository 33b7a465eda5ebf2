"""Whatever a study file holds is a study or one sentence that names the file; whatever is chosen, all is counted."""

import itertools
import json
import math

import numpy as np
import pytest
from arc_cases import observed_at
from hypothesis import given, reject
from hypothesis import strategies as st

import radioloc
from radioloc import LunarPosition, StationCatalogue
from radioloc.errors import InputError
from radioloc.jobs.selection import select_observations
from radioloc.measurements import Link
from radioloc.parameters.parameter import ParameterSet
from radioloc.study import ObservationChoice
from radioloc.targets.surface_point import on_sphere

# What a careless hand or a broken script may put in the place of a value, as TOML.
VALUES = st.one_of(
    st.sampled_from(
        ["", "[]", "{}", "nan", "-inf", "true", '""', '"x"', '["x"]', "[1, 2, 3]", "[[1]]", "1e400"]
    ),
    st.sampled_from(
        ["2006-04-07", "2006-04-07T00:00:00", "12:00:00", "2006-04-07T00:00:00-05:00", '"*"', '"/"']
    ),
    st.sampled_from(
        ["{ height_m = 0, sigma_m = 1 }", '{ dem = "x" }', '"all"', '"none"', '"cartesian"', "0x10"]
    ),
    st.integers(-(10**30), 10**30).map(str),
    st.floats(allow_nan=False, allow_infinity=False).map(repr),
    st.text(max_size=8).map(lambda text: json.dumps(text, ensure_ascii=True)),
)
KEYS = {
    "target": ["frame", "longitude_deg", "latitude_deg", "height_m", "position_m", "name"],
    "observations": [
        "files",
        "targets",
        "stations",
        "start",
        "stop",
        "hours",
        "doppler_average_s",
        "extra_sigma_m",
        "vlbi_station_sigma_m",
    ],
    "estimate": [
        *("position", "range_bias", "range_bias_sigma_m", "time_bias", "time_bias_sigma_s"),
        *("height_prior", "ephemeris_sigma_m", "rejection_sigma", "weights"),
    ],
    "model": ["off", "ephemeris", "libration", "earth_orientation"],
    "stations.APOLLO": ["itrf_m", "velocity_m_yr", "epoch", "aliases"],
    "reference": ["frame", "longitude_deg", "latitude_deg", "height_m", "position_m", "name"],
}
GOOD = {
    ("target", "longitude_deg"): "3.5",
    ("target", "latitude_deg"): "26.0",
    ("target", "height_m"): "-1000.0",
    ("observations", "files"): '["d.csv"]',
    ("stations.APOLLO", "itrf_m"): "[-1463998.9085, -5166632.7635, 3435012.8835]",
    ("reference", "position_m"): "[1554678.949, 98094.118, 765004.906]",
}
PLACES = [(table, key) for table, keys in KEYS.items() for key in keys]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("study")
    (folder / "d.csv").write_text("x", encoding="utf-8")
    return folder


def read_or_refuse(folder, content):
    path = folder / "s.toml"
    path.write_bytes(content)
    try:
        return radioloc.read_study(path)
    except InputError as error:
        message = str(error)
    assert message.startswith(f"{path}: ")
    return None


@given(changes=st.dictionaries(st.sampled_from(PLACES), VALUES, min_size=1, max_size=3))
def test_a_study_with_wrong_values_is_refused_in_words_or_read(changes, folder):
    content = {**GOOD, **changes}
    lines = []
    for table in KEYS:
        lines.append(f"[{table}]")
        lines += [f"{key} = {value}" for (of, key), value in content.items() if of == table]
    read_or_refuse(folder, "\n".join(lines).encode())


@given(
    content=st.one_of(
        st.binary(max_size=60), st.text(alphabet='[]{}="\n.,#ab1-T:', max_size=60).map(str.encode)
    )
)
def test_any_bytes_are_refused_in_words(content, folder):
    assert read_or_refuse(folder, content) is None


LINKS = [
    Link(a, t, b) for (a, b), t in itertools.product([("APOLLO",) * 2, ("GRASSE", "MATERA")], ["a", "b"])
]
DAYS = 2460432.5


@given(data=st.data())
def test_every_observation_is_kept_or_counted(data):
    n = data.draw(st.integers(1, 12))
    link = data.draw(st.lists(st.integers(0, 3), min_size=n, max_size=n))
    fraction = data.draw(st.lists(st.floats(0.0, 0.999), min_size=n, max_size=n))
    given = observed_at(
        radioloc.Epochs.from_jd(np.full(n, DAYS), np.array(fraction), "UTC"),
        LINKS,
        tag="transmit",
        link=link,
        value_m=7.7e8 + np.arange(n),
        sigma_m=0.01,
    )
    choice = ObservationChoice(
        targets=data.draw(st.sampled_from([None, "a", "b"])),
        stations=data.draw(st.sampled_from([None, "7045", ("GRASSE", "MATERA"), ("APOLLO", "GRASSE")])),
        hours=data.draw(st.one_of(st.none(), st.floats(0.01, 30.0))),
    )
    try:
        kept, left_out = select_observations(given, choice, StationCatalogue.default())
    except InputError:
        reject()
    assert 0 < len(kept) == n - sum(left_out.values())
    assert all(count > 0 for count in left_out.values())
    assert (np.diff(kept.value_m) > 0.0).all()  # in input order
    wanted = [choice.targets in (None, (LINKS[i].target,)) for i in link]
    assert left_out.get("other target", 0) == wanted.count(False)
    if choice.hours is not None:
        times_h = 24.0 * kept.epoch.fraction
        assert times_h.max() - times_h.min() <= choice.hours + 1e-6


@given(
    longitude_deg=st.floats(-180.0, 180.0),
    latitude_deg=st.floats(-90.0, 90.0),
    east_m=st.floats(-5e6, 5e6),
    north_m=st.floats(-5e6, 5e6),
    height_m=st.floats(-1e4, 1e4),
)
def test_coordinates_on_the_sphere_have_no_pole_to_stumble_over(
    longitude_deg, latitude_deg, east_m, north_m, height_m
):
    start = LunarPosition.from_selenographic(longitude_deg, latitude_deg, 100.0)
    parameters, position = on_sphere(start.xyz_m, None)
    assert position(ParameterSet(parameters).prior_values)[0] == pytest.approx(start.xyz_m, abs=1e-6)
    point_m, partials = position(np.array([east_m, north_m, height_m]))
    assert np.linalg.norm(point_m) == pytest.approx(1737400.0 + height_m, abs=1e-6)
    assert np.isfinite(partials).all()
    angle = math.acos(
        np.clip(point_m @ start.xyz_m / np.linalg.norm(point_m) / np.linalg.norm(start.xyz_m), -1.0, 1.0)
    )
    # Spherical triangle with a right angle: cos c = cos a cos b.
    expected = math.acos(np.clip(math.cos(east_m / 1737400.0) * math.cos(north_m / 1737400.0), -1.0, 1.0))
    assert angle == pytest.approx(expected, abs=1e-6)
