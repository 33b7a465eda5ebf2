"""Solutions for other tools: SPICE computes with the kernels, GDAL reads the layers."""

import json
import math
import tempfile

import numpy as np
import pytest
import spiceypy
from recorded import recorded, reference
from spiceypy.utils.exceptions import SpiceyError

from radioloc.cli import main
from radioloc.ephemeris import Ephemeris, LunarOrientation, Trajectory
from radioloc.errors import InputError
from radioloc.io import write_gis, write_spice
from radioloc.kernels import find_kernel
from radioloc.kernels.daf import read_segments
from radioloc.lunar import east_north_up, rot_icrf_to_pa, rot_pa_to_me
from radioloc.time import Epochs

PLACE = (-51.91637, 43.05784, -2570.25)
COVARIANCE = np.array([[100.0, 30.0, 0.0], [30.0, 50.0, 0.0], [0.0, 0.0, 9.0]])


def content(ephemeris="DE421", place=PLACE, covariance=COVARIANCE, name="lander 5"):
    """Return what a solution.json holds of a position."""
    references = reference("benchmark", -51.9, 43.0, -2500.0)
    matrix = {"enu_m2": np.where(np.isfinite(covariance), covariance, None).tolist()}
    sigma_m = np.sqrt(np.diag(covariance))
    return recorded(name, place, sigma_m, f"ME_{ephemeris}", covariance=matrix, reference=references)


@pytest.mark.parametrize("ephemeris", ["DE421", "DE440"])
def test_earth_direction_by_spice_from_the_lander_frame(tmp_path, ephemeris):
    solution = content(ephemeris)
    files = write_spice(tmp_path / "lander.bsp", solution)
    seconds = np.array([660446863.123, 978361445.0])
    tdb = Epochs.from_tdb_seconds(seconds)
    kernels = [find_kernel(ephemeris, kind) for kind in ("SPK", "PCK")]
    with spiceypy.KernelPool([str(file) for file in (*kernels, *files)]):
        position_km = spiceypy.spkpos("EARTH", seconds, "LANDER_5_TOPO", "NONE", "LANDER_5")[0]
        mean = {"DE421": "MOON_ME_DE421", "DE440": "MOON_ME_DE440_ME421"}[ephemeris]
        range_km, longitude_rad, latitude_rad = spiceypy.reclat(
            spiceypy.spkpos("LANDER_5", seconds[0], mean, "NONE", "MOON")[0]
        )
    assert math.degrees(longitude_rad) == pytest.approx(PLACE[0], abs=1e-10)
    assert math.degrees(latitude_rad) == pytest.approx(PLACE[1], abs=1e-10)
    assert range_km == pytest.approx(1737.4 + PLACE[2] / 1e3, abs=1e-9)

    opened = Ephemeris.open(ephemeris)
    moon_m, _ = opened.geocentric("moon", tdb)
    rot_to_pa = rot_icrf_to_pa(LunarOrientation.open(ephemeris).angles(tdb)[0])
    lander_pa_m = np.array([solution["position"]["pa"][f"{axis}_m"] for axis in "xyz"])
    to_earth_pa_m = np.einsum("nij,nj->ni", rot_to_pa, -moon_m) - lander_pa_m
    to_enu = east_north_up(math.radians(PLACE[0]), math.radians(PLACE[1])) @ rot_pa_to_me(opened.constants)
    east_m, north_m, up_m = to_enu @ to_earth_pa_m.T
    np.testing.assert_allclose(position_km.T * 1e3, [north_m, -east_m, up_m], atol=0.002)


@pytest.mark.parametrize(
    ("change", "name", "code", "message"),
    [({}, "lander.bsp", 399, "NAIF code"), ({"position": None}, "lander.bsp", 301001, "expected a position")],
)
def test_kernels_that_would_be_wrong_are_refused(tmp_path, change, name, code, message):
    with pytest.raises(InputError, match=message):
        write_spice(tmp_path / name, content() | change, body=code)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("name", "frame", "segment"),
    [
        ("Чанъэ 5", "5_TOPO", "????? 5"),
        ("Gómez", "GOMEZ_TOPO", "Gomez"),
        ("嫦娥\n\\begindata", "BEGINDATA_TOPO", "???\\begindata"),
        ("a" * 300, f"{'A' * 21}_TOPO", "a" * 40),
        ("", "LANDER_TOPO", "lander"),
    ],
)
def test_any_name_becomes_printable_ascii_of_the_length_that_spice_takes(tmp_path, name, frame, segment):
    files = write_spice(tmp_path / "lander.bsp", content(name=name))
    assert files[1].read_text().isascii()
    assert [item.name for item in read_segments(files[0], "SPK")] == [segment]
    with spiceypy.KernelPool([str(file) for file in files]):
        assert spiceypy.namfrm(frame) != 0


def test_paths_too_long_for_spice_are_written_and_read(tmp_path, monkeypatch):
    folder = tmp_path.joinpath(*["d" * 100] * 3)
    folder.mkdir(parents=True)
    spk, frames = write_spice(folder / "lander.bsp", content())
    assert sorted(path.name for path in folder.iterdir()) == ["lander.bsp", "lander.tf"]
    assert "LANDER_5_TOPO" in frames.read_text()
    lander = Trajectory.open(spk, 301001)
    assert np.isfinite(lander.geocentric(Ephemeris.open(), Epochs.from_tdb_seconds(np.array([0.0])))[0]).all()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    with pytest.raises(InputError, match="folder for temporary files"):
        write_spice(tmp_path / "lander.bsp", content())
    assert not list(tmp_path.glob("lander*"))


def test_kernels_that_spice_cannot_write_leave_none_and_those_before(tmp_path, monkeypatch):
    def failing(*_):
        raise SpiceyError("no room")

    monkeypatch.setattr(spiceypy, "spkw09", failing)
    (tmp_path / "lander.tf").write_text("before")
    with pytest.raises(InputError, match=r"lander\.bsp.*SPICE:"):
        write_spice(tmp_path / "lander.bsp", content())
    assert [path.name for path in tmp_path.iterdir()] == ["lander.tf"]
    assert (tmp_path / "lander.tf").read_text() == "before"


@pytest.mark.parametrize("ending", ["geojson", "gpkg"])
def test_gdal_reads_positions_and_ellipses_on_the_moon(tmp_path, ending):
    raw = pytest.importorskip("pyogrio.raw")
    import pyogrio

    file = write_gis(tmp_path / f"lander.{ending}", [content()])
    layers = [name for name, _ in pyogrio.list_layers(file)]
    assert len(layers) == (2 if ending == "gpkg" else 1)
    rows = {}
    for layer in layers:
        assert "1737400" in pyogrio.read_info(file, layer=layer)["crs"]
        meta, _, geometry, columns = raw.read(file, layer=layer)
        for item, name in zip(geometry, columns[list(meta["fields"]).index("name")], strict=True):
            rows[name] = item
    assert sorted(rows) == ["benchmark", "lander 5", "lander 5, 1 sigma", "lander 5, 95 %"]
    np.testing.assert_allclose(np.frombuffer(rows["lander 5"][5:]), PLACE[:2], atol=1e-12)


@pytest.mark.parametrize("place", [(-51.9, 89.999), (180.0, -89.9999), (130.0, 89.99), (0.0, 43.0)])
def test_a_ring_holds_its_centre_and_no_far_point_also_around_a_pole(tmp_path, place):
    from matplotlib.path import Path as Outline

    file = write_gis(tmp_path / "lander.geojson", [content(place=(*place, 0.0), covariance=1e4 * COVARIANCE)])
    features = json.loads(file.read_text())["features"]
    rings = [
        np.array(f["geometry"]["coordinates"][0]) for f in features if f["geometry"]["type"] == "Polygon"
    ]
    assert len(rings) == 2
    for ring in rings:
        assert (ring[0] == ring[-1]).all()
        assert np.abs(ring[:, 1]).max() <= 90.0
        outline = Outline(ring)
        assert outline.contains_point(place)
        assert not outline.contains_point((place[0], place[1] - math.copysign(0.2, place[1])))


@pytest.mark.parametrize("longitude_deg", [PLACE[0], 179.99999])
def test_the_ellipse_is_that_of_the_covariance(tmp_path, longitude_deg):
    file = write_gis(tmp_path / "lander.geojson", [content(place=(longitude_deg, *PLACE[1:]))])
    rings = {
        feature["properties"]["name"]: np.array(feature["geometry"]["coordinates"][0])
        for feature in json.loads(file.read_text())["features"]
        if feature["geometry"]["type"] == "Polygon"
    }
    metres = math.radians(1737400.0) * np.array([math.cos(math.radians(PLACE[1])), 1.0])
    inverse = np.linalg.inv(COVARIANCE[:2, :2])
    for name, squared in (("1 sigma", 1.0), ("95 %", 5.991465)):
        offset = (rings[f"lander 5, {name}"] - [longitude_deg, PLACE[1]]) * metres
        np.testing.assert_allclose(np.einsum("ni,ij,nj->n", offset, inverse, offset), squared, rtol=1e-4)
        assert (offset[0] == offset[-1]).all()


@pytest.mark.parametrize("ending", ["geojson", "md"])
def test_all_targets_are_exported_with_the_references_of_the_first(tmp_path, ending):
    located = ("position", "sigma", "covariance")
    first, second = content(), content(place=(-51.9, 43.1, -2500.0))
    targets = {
        name: {key: item[key] for key in located} | {"priors": []}
        for name, item in (("A", first), ("B", second))
    }
    (tmp_path / "solution.json").write_text(json.dumps(first | {"targets": targets}))
    out = tmp_path / f"a.{ending}"
    spk = ["export", str(tmp_path / "solution.json"), str(tmp_path / "a.bsp")]
    assert main(spk) == 2
    assert main([*spk, "--target", "b"]) == 0
    assert main([*spk, "--target", "C"]) == 2
    assert "LANDER_5_B" in (tmp_path / "a.tf").read_text()
    assert main(["export", str(tmp_path / "solution.json"), str(out)]) == 0
    if ending == "md":
        assert "lander 5, A | lander 5, B" in out.read_text()
        assert main(["export", str(tmp_path / "solution.json"), str(out), "--target", "b"]) == 0
        assert "lander 5, A" not in out.read_text()
        return
    points = [f for f in json.loads(out.read_text())["features"] if f["geometry"]["type"] == "Point"]
    places = {point["properties"]["name"]: point["geometry"]["coordinates"] for point in points}
    assert places == {"lander 5, A": [*PLACE[:2]], "lander 5, B": [-51.9, 43.1], "benchmark": [-51.9, 43.0]}


def test_a_position_without_a_covariance_has_no_ellipse(tmp_path):
    undetermined = content(covariance=np.diag([np.inf] * 3))
    features = json.loads(write_gis(tmp_path / "a.geojson", [undetermined]).read_text())["features"]
    assert [feature["geometry"]["type"] for feature in features] == ["Point", "Point"]


def test_export_command_writes_the_format_of_the_ending(tmp_path, capsys):
    solution = tmp_path / "solution.json"
    solution.write_text(json.dumps(content()))
    for name, written in (("a.geojson", ["a.geojson"]), ("b.bsp", ["b.bsp", "b.tf"])):
        assert main(["export", str(solution), str(tmp_path / name)]) == 0
        assert all(str(tmp_path / item) in capsys.readouterr().out for item in written[:1])
        assert all((tmp_path / item).exists() for item in written)
    assert main(["export", str(solution), str(tmp_path / "c.kml")]) == 2
    assert "supported: .geojson, .gpkg, .bsp, .oem, .md, .tex, .snx" in capsys.readouterr().err
    assert main(["export", str(solution), str(solution), str(tmp_path / "d.bsp")]) == 2
    assert "expected one position" in capsys.readouterr().err
