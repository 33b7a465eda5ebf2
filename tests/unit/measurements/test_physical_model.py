"""Physical models: files, terms and provenance."""

import pytest

from radioloc.earth.stations import StationCatalogue
from radioloc.errors import FileFormatError, InputError, KernelError
from radioloc.kernels import find_kernel
from radioloc.measurements.physical_model import PhysicalModel


def test_unknown_terms_have_a_suggestion(model):
    with pytest.raises(InputError, match=r"got 'shapero' .*'shapiro'"):
        model.without("shapero")
    with pytest.raises(InputError, match="expected one of shapiro"):
        PhysicalModel.build(off=["xyz"])


def test_without_terms_copies_the_model(model):
    reduced = model.without("shapiro", "subdaily_eop")
    assert not reduced.has("shapiro")
    assert reduced.has("tdb_tt")
    assert not reduced.earth.subdaily_tides
    assert not reduced.earth.libration
    assert reduced.earth.zonal_tides
    assert model.has("shapiro")
    assert model.earth.subdaily_tides
    # Terms remain switched off.
    assert not reduced.without("tdb_tt").has("shapiro")
    assert not reduced.without("tdb_tt").earth.subdaily_tides
    assert PhysicalModel.build(off=["shapiro", "subdaily_eop"]).terms == reduced.terms


def test_files_and_catalogue_of_the_user(tmp_path):
    catalogue = StationCatalogue([StationCatalogue.default()["APOLLO"]])
    by_path = PhysicalModel.build(
        ephemeris=find_kernel("DE421", "SPK"), libration=find_kernel("DE421", "PCK"), catalogue=catalogue
    )
    assert by_path.ephemeris.name == "DE421"
    assert len(by_path.catalogue) == 1
    with pytest.raises(KernelError):
        PhysicalModel.build(ephemeris=tmp_path / "missing.bsp")
    with pytest.raises(FileFormatError, match=r"missing\.txt: no such file"):
        PhysicalModel.build(earth_orientation=tmp_path / "missing.txt")


def test_positions_and_orientation_need_the_same_ephemeris(monkeypatch):
    import dataclasses

    from radioloc.ephemeris import CONSTANTS, Ephemeris

    de440 = dataclasses.replace(Ephemeris.open(), name="DE440", constants=CONSTANTS["DE440"])
    monkeypatch.setattr(Ephemeris, "open", classmethod(lambda cls, spk: de440))
    with pytest.raises(InputError, match="DE440, got DE421"):
        PhysicalModel.build()


def test_missing_planets_of_a_kernel(model, monkeypatch):
    from radioloc.ephemeris import Ephemeris

    assert model.missing_planets == ()
    monkeypatch.setattr(Ephemeris, "bodies", ("sun", "moon", "venus"))
    assert model.missing_planets == ("jupiter", "saturn")
    assert model.without("shapiro").missing_planets == ()


def test_orientation_beyond_the_table(model):
    assert model.earth.table.beyond is None
    extended = PhysicalModel.build(eop_beyond="hold").earth.table
    assert extended.beyond == ("hold", model.earth.table.mjd_utc[-1])
    assert extended.mjd_utc[-1] > model.earth.table.mjd_utc[-1] + 1000.0
