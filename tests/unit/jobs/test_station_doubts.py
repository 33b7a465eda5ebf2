"""Stations whose coordinates are exchanged or have another sign are named, whatever the fit makes of them."""

import csv

import pytest
from paths import EXAMPLES

import radioloc
from radioloc.earth import StationCatalogue

SHORT_ARC = EXAMPLES / "change5" / "short_arc.csv"
STUDY = """
[target]
longitude_deg = -51.88
latitude_deg = 43.02
height_m = -2500.0
[observations]
files = ["ranges.csv"]
[estimate]
height_prior = { height_m = -2550.4, sigma_m = 1.0 }
[consider]
defaults = false
[stations.OURS]
"""
X, Y, Z = StationCatalogue.default()["KASHI"].itrf_m.tolist()


def notes(folder, place, name="OURS"):
    text = SHORT_ARC.read_text(encoding="utf-8").replace("KASHI", name)
    rows = [line for line in text.splitlines() if not line.startswith("#")]
    with (folder / "ranges.csv").open("w", encoding="utf-8") as file:
        csv.writer(file).writerows(row for k, row in enumerate(csv.reader(rows)) if k % 10 < 3)
    (folder / "study.toml").write_text(STUDY + place, encoding="utf-8")
    return "\n".join(radioloc.locate(folder / "study.toml").notes)


@pytest.mark.parametrize(
    ("place", "mistake"),
    [
        (f"itrf_m = [{Y}, {X}, {Z}]", "with x and y exchanged"),  # does not see the Moon
        (f"itrf_m = [{X}, {Z}, {Y}]", "with y and z exchanged"),  # sees it, 400 km off
        (f"itrf_m = [{X}, {Y}, {-Z}]", "with the other sign of z"),
        ("longitude_deg = -76.71\nlatitude_deg = 38.42\nheight_m = 1200.0", "with the other sign of y"),
        ("longitude_deg = 1.338842\nlatitude_deg = 0.670485\nheight_m = 1270.0", "in degrees, not radians"),
        ("longitude_deg = 38.42\nlatitude_deg = 76.71\nheight_m = 1200.0", "longitude and latitude exch"),
    ],
)
def test_exchanged_coordinates_are_recognised(tmp_path, place, mistake):
    output = notes(tmp_path, place)
    assert "check the coordinates in [stations.OURS]" in output
    assert mistake in output


def test_coordinates_as_they_should_be_are_not_doubted(tmp_path):
    assert "[stations.OURS]" not in notes(tmp_path, f"itrf_m = [{X}, {Y}, {Z}]")


def test_coordinates_without_a_model_are_no_candidate(tmp_path):
    """With x and z exchanged, the height of this place is outside the model of the troposphere."""
    x, y, z = StationCatalogue.default()["KUNMING"].itrf_m.tolist()
    assert "[stations.OURS]" not in notes(tmp_path, f"itrf_m = [{x}, {y}, {z}]")
