"""Representations of objects in notebooks: one line that identifies the object, without arrays."""

from paths import EXAMPLES

import radioloc
from radioloc.lunar import TerrainModel


def test_objects_are_shown_in_one_line():
    study = radioloc.read_study(EXAMPLES / "apollo15" / "apollo15.toml")
    arc = radioloc.jobs.prepare_arc(study)
    solution = radioloc.locate(study)
    objects = [
        *(study, study.target, arc.model, arc.observations, arc, arc.compute()),
        *(solution, solution.parameters, solution.residuals, solution.consider, solution.consistency),
        arc.model.without("shapiro", "pole_tide"),
        radioloc.simulate(EXAMPLES / "change5" / "simulation.toml", seed=3),
        TerrainModel.open(EXAMPLES / "change5" / "ldem_4_landing_site.tif"),
        radioloc.read_study(EXAMPLES / "reflectors" / "de421.toml"),
    ]
    for shown in objects:
        assert repr(shown).startswith(f"<{type(shown).__name__} ")
        assert len(repr(shown)) < 240
        assert "array(" not in repr(shown)
        assert "\n" not in repr(shown)
