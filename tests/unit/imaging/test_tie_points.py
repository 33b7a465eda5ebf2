"""Files of tie points, in and out."""

from __future__ import annotations

from dataclasses import replace

import pytest
from image_descents import Descent

from radioloc.errors import FileFormatError, InputError
from radioloc.imaging.maps import Map
from radioloc.imaging.tie_points import Measurement, TiePoint, read_tie_points, write_tie_points

POINTS = [
    TiePoint(
        "5",
        (Measurement("a.png", 10.25, 20.5, 0.5), Measurement("b.png", 3.0, 4.0, 2.0)),
        -19.51,
        44.12,
        25.0,
    ),
    TiePoint("7", (Measurement("a.png", 0.0, 0.0, 0.5),), -19.52, 44.13, 10.0),
]
FREE = TiePoint("9", (Measurement("a.png", 1.0, 2.0, 0.5), Measurement("b.png", 5.0, 6.0, 0.5)))


def test_the_example_of_asp_s_manual(tmp_path):
    (tmp_path / "a.gcp").write_text(
        "# WKT: a comment\n5 23.7 160.1 427.1 1.0 1.0 1.0 image1.tif 124.5 19.7 1.0 1.0 image2.tif 254.3 73.9 1.0 1.0\n"
    )
    measured = (Measurement("image1.tif", 124.5, 19.7), Measurement("image2.tif", 254.3, 73.9))
    assert read_tie_points(tmp_path / "a.gcp") == [TiePoint("5", measured, 160.1, 23.7, 1.0, 427.1)]


def test_qgis_counts_from_the_corner_and_upward(tmp_path):
    """The centre of the image's first pixel is half a pixel right of and below the corner; the last is not enabled."""
    (tmp_path / "a.png.points").write_text(
        '#CRS: GEOGCRS["Moon"]\nmapX,mapY,sourceX,sourceY,enable,dX,dY,residual\n'
        "-19.5,44.1,0.5,-0.5,1,0,0,0\n-19.6,44.2,100.0,-50.0,1,0,0,0\n1,1,1,-1,0,0,0,0\n"
    )
    first, second = read_tie_points(tmp_path / "a.png.points")
    assert (first.longitude_deg, first.latitude_deg, first.measurements) == (
        -19.5,
        44.1,
        (Measurement("a.png", 0.0, 0.0),),
    )
    assert second.measurements == (Measurement("a.png", 99.5, 49.5),)


def test_qgis_in_the_projection_of_a_map(tmp_path):
    base = Map.open(Descent().write_map(tmp_path / "map.tif"))
    (tmp_path / "a.points").write_text(
        "mapX,mapY,pixelX,pixelY,enable\n0.0,0.0,1.0,-1.0,1\n0.0,606.468,1.0,-1.0,1\n"
    )
    first, second = read_tie_points(tmp_path / "a.points", base=base)
    assert (first.longitude_deg, first.latitude_deg) == pytest.approx((-19.51, 44.12), abs=1e-9)
    assert second.latitude_deg == pytest.approx(44.14, abs=1e-7)  # 1737.4 km times 0.02 degrees
    write_tie_points(tmp_path / "b.points", [first, second], image="a", base=base)
    assert read_tie_points(tmp_path / "b.points", image="a", base=base)[1].latitude_deg == pytest.approx(
        44.14, abs=1e-7
    )


@pytest.mark.parametrize("name", ["a.gcp", "a.csv"])
def test_there_and_back(tmp_path, name):
    points = POINTS if name == "a.gcp" else [*POINTS, FREE]
    write_tie_points(tmp_path / name, points)
    assert read_tie_points(tmp_path / name) == points


def test_qgis_there_and_back(tmp_path):
    write_tie_points(tmp_path / "a.points", POINTS, image="a.png")
    back = read_tie_points(tmp_path / "a.points", image="a.png")
    for point, found in zip(POINTS, back, strict=True):
        measured = replace(point.measurements[0], sigma_px=1.0)
        assert found == TiePoint(found.name, (measured,), point.longitude_deg, point.latitude_deg)


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.gcp", "5 23.7 160.1 427.1 1 1 1 a.png 1 2 1\n", r"a\.gcp, line 1: 11 fields; a point has"),
        ("a.gcp", "\n5 23.7 x 427.1 1 1 1\n", r"line 2: 'x' is not a number"),
        ("a.gcp", "5 23.7 nan 427.1 1 1 1\n", "'nan' is not a number"),
        ("a.gcp", "5 23.7 160.1 427.1 1 0 1\n", "a sigma is 0, not positive"),
        ("a.gcp", "5 23000.7 160.1 427.1 1 1 1\n", "are they metres of a projection"),
        ("a.gcp", "# nothing\n", "has no tie points"),
        ("a.points", "1,2,3,4,1\n", "has no heading mapX,mapY,sourceX,sourceY,enable"),
        ("a.points", "mapX,mapY,sourceX,sourceY,enable\n1,2,3\n", "line 2: 3 fields"),
        ("a.csv", "point,image,sample\n", "has no heading with point, image, sample, line"),
        ("a.csv", "point,image,sample,line,colour\n", r"has columns \['colour'\]"),
        ("a.csv", "point,image,sample,line\n1,a,1\n", "line 2: 3 fields where the heading has 4"),
        (
            "a.csv",
            "point,image,sample,line,longitude_deg,latitude_deg\n1,a,1,2,3,\n",
            "is empty, but not both",
        ),
        (
            "a.csv",
            "point,image,sample,line,longitude_deg,latitude_deg\n1,a,1,2,3,4\n1,b,1,2,3,5\n",
            "point '1' has two places",
        ),
    ],
)
def test_files_refused(tmp_path, name, text, message):
    (tmp_path / name).write_text(text)
    with pytest.raises(FileFormatError, match=message):
        read_tie_points(tmp_path / name)


def test_what_a_format_cannot_hold(tmp_path):
    with pytest.raises(InputError, match=r"9 has no place on the Moon, which a\.gcp needs"):
        write_tie_points(tmp_path / "a.gcp", [FREE])
    with pytest.raises(InputError, match=r"no point is measured in 'c\.png'"):
        write_tie_points(tmp_path / "c.png.points", POINTS)
