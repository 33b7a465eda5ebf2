"""Studies: the tables of a study file as records, and the reader of study files."""

from radioloc.study.map_positions import PlaceOnMap
from radioloc.study.observation_choice import ObservationChoice, Uplink, Weight
from radioloc.study.schema import STUDY_TABLES, StudyTable
from radioloc.study.study import EstimateChoice, HeightPrior, ModelChoice, Reference, Study, TerrainPrior
from radioloc.study.study_file import read_study

__all__ = [
    "STUDY_TABLES",
    "EstimateChoice",
    "HeightPrior",
    "ModelChoice",
    "ObservationChoice",
    "PlaceOnMap",
    "Reference",
    "Study",
    "StudyTable",
    "TerrainPrior",
    "Uplink",
    "Weight",
    "read_study",
]
