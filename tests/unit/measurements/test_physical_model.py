"""What a model is built of, and what it says it rests on."""

import pytest

from radioloc.earth.stations import StationCatalogue
from radioloc.errors import FileFormatError, InputError, KernelError
from radioloc.kernels import find_kernel
from radioloc.measurements.physical_model import PhysicalModel


def test_unknown_term_gets_the_nearest(model):
    with pytest.raises(InputError, match=r"'shapero' is not a term .*did you mean 'shapiro'\?"):
        model.without("shapero")
    with pytest.raises(InputError, match="the terms are shapiro, tdb_tt"):
        PhysicalModel.build(off=["xyz"])


def test_leaving_out_leaves_the_first_model_alone(model):
    fewer = model.without("shapiro", "subdaily_eop")
    assert not fewer.has("shapiro")
    assert fewer.has("tdb_tt")
    assert not fewer.earth.subdaily_tides
    assert not fewer.earth.libration
    assert fewer.earth.zonal_tides
    assert model.has("shapiro")
    assert model.earth.subdaily_tides
    # What was out stays out.
    assert not fewer.without("tdb_tt").has("shapiro")
    assert not fewer.without("tdb_tt").earth.subdaily_tides
    assert PhysicalModel.build(off=["shapiro", "subdaily_eop"]).terms == fewer.terms


def test_provenance_names_files_and_checksums(model):
    record = model.without("shapiro").provenance()
    assert record["terms_off"] == ["shapiro"]
    assert record["ephemeris"]["name"] == "DE421"
    assert record["ephemeris"]["sha256"] == model.ephemeris.kernel.sha256
    assert len(record["ephemeris"]["sha256"]) == 64
    assert record["lunar_orientation"]["name"] == "PA_DE421"
    assert "TDB" not in record["lunar_orientation"]["file"]
    assert record["earth_orientation"]["first"] <= "1972-01-02"
    assert record["earth_orientation"]["last_measured"] < record["earth_orientation"]["last"]
    assert any("astropy-iers-data" in source for source in record["earth_orientation"]["tables"])


def test_files_and_catalogue_of_ones_own(tmp_path):
    own = StationCatalogue([StationCatalogue.default()["APOLLO"]])
    by_path = PhysicalModel.build(
        ephemeris=find_kernel("DE421", "SPK"), libration=find_kernel("DE421", "PCK"), catalogue=own
    )
    assert by_path.ephemeris.name == "DE421"
    assert len(by_path.catalogue) == 1
    with pytest.raises(KernelError):
        PhysicalModel.build(ephemeris=tmp_path / "missing.bsp")
    with pytest.raises(FileFormatError, match=r"missing\.txt: no such file"):
        PhysicalModel.build(earth_orientation=tmp_path / "missing.txt")


def test_positions_and_orientation_of_two_ephemerides_are_refused(monkeypatch):
    import dataclasses

    from radioloc.ephemeris import CONSTANTS, Ephemeris

    other = dataclasses.replace(Ephemeris.open(), name="DE440", constants=CONSTANTS["DE440"])
    monkeypatch.setattr(Ephemeris, "open", classmethod(lambda cls, spk: other))
    with pytest.raises(InputError, match="that of DE421 but the positions are those of DE440"):
        PhysicalModel.build()


def test_planets_that_the_kernel_lacks_are_told(model, monkeypatch):
    from radioloc.ephemeris import Ephemeris

    assert model.missing_planets == ()
    monkeypatch.setattr(Ephemeris, "bodies", ("sun", "moon", "venus"))
    assert model.missing_planets == ("jupiter", "saturn")
    assert model.without("shapiro").missing_planets == ()


def test_orientation_of_later_years_is_asked_for(model):
    assert model.earth.table.beyond is None
    held = PhysicalModel.build(eop_beyond="hold").earth.table
    assert held.beyond == ("hold", model.earth.table.mjd_utc[-1])
    assert held.mjd_utc[-1] > model.earth.table.mjd_utc[-1] + 1000.0
