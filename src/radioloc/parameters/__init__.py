"""Parameters of the observations: kinds, scopes and partial derivatives.

:data:`PARAMETERS` are the kinds of parameter (:class:`ParameterKind`); a study chooses of which stations, passes, links
or targets they are estimated, considered or held at a value (:class:`ParameterChoice`), which makes each a
:class:`Parameter` with a :class:`Role`.
"""

from radioloc.parameters.choice import ParameterChoice
from radioloc.parameters.kind import ParameterKind, Scope
from radioloc.parameters.parameter import Parameter, ParameterSet, Role
from radioloc.parameters.registry import PARAMETERS
from radioloc.parameters.rows import ObservationRows

__all__ = [
    "PARAMETERS",
    "ObservationRows",
    "Parameter",
    "ParameterChoice",
    "ParameterKind",
    "ParameterSet",
    "Role",
    "Scope",
]
