"""What moves a spacecraft about the Moon."""

from radioloc.dynamics.gravity import GravityField

__all__ = ["GravityField"]
