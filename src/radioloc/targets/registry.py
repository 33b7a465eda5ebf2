"""Registry of further kinds of target, by the entry points ``radioloc.targets`` or :func:`radioloc.register`.

Positions, trajectories and orbiters need no ``kind``: their keys in ``[target]`` distinguish them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from radioloc.measurements.physical_model import PhysicalModel
from radioloc.parameters.parameter import Role
from radioloc.plugins import Registry
from radioloc.targets.target import Target


@runtime_checkable
class TargetDescription(Protocol):
    """A-priori description of a target: a dataclass whose fields are the keys of its table in a study file."""

    def target(self, name: str, model: PhysicalModel, role: Role = Role.ESTIMATED) -> Target:
        """Return the target with a name, which is empty if it is the only one, and parameters of a role."""
        ...


@dataclass(frozen=True, slots=True)
class TargetKind:
    """Kind of target of a study file."""

    name: str  #: unique name: ``kind`` of ``[target]`` and ``[targets.NAME]``
    record: type[TargetDescription]  #: dataclass of the other keys, a :class:`TargetDescription`


TARGET_KINDS: Mapping[str, TargetKind] = Registry("radioloc.targets", TargetKind, ())
"""Kinds by name."""
