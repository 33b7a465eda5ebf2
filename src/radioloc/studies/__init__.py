"""Whole jobs: a study file in, a solution out. The jobs themselves are functions of :mod:`radioloc`."""

from radioloc.studies.arcs import leave_one_out
from radioloc.studies.comparison import compare
from radioloc.studies.image_study import (
    CameraChoice,
    ImageChoice,
    ImagePointChoice,
    ImageStudy,
    Landmark,
    PointStudy,
    StereoChoice,
    read_image_study,
)
from radioloc.studies.locate import arc_of
from radioloc.studies.map_positions import PlaceOnMap
from radioloc.studies.observation_choice import ObservationChoice
from radioloc.studies.passes import light_times, visibility
from radioloc.studies.study import (
    EstimateChoice,
    HeightPrior,
    ModelChoice,
    Reference,
    Study,
    TerrainPrior,
)
from radioloc.studies.study_file import read_study
from radioloc.studies.verification import Verification, verify
from radioloc.studies.weights import Weight

__all__ = [
    "CameraChoice",
    "EstimateChoice",
    "HeightPrior",
    "ImageChoice",
    "ImagePointChoice",
    "ImageStudy",
    "Landmark",
    "ModelChoice",
    "ObservationChoice",
    "PlaceOnMap",
    "PointStudy",
    "Reference",
    "StereoChoice",
    "Study",
    "TerrainPrior",
    "Verification",
    "Weight",
    "arc_of",
    "compare",
    "leave_one_out",
    "light_times",
    "read_image_study",
    "read_study",
    "verify",
    "visibility",
]
