"""Where a lander stands on the Moon, from Earth-based tracking, with how well it is known."""

from radioloc._version import __version__

__all__ = ["__version__"]
