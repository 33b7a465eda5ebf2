"""A film of water on the radome of a station delays radio signals by 4 mm."""

import numpy as np

from radioloc.media import LegDelay


class WetRadome:
    name, description, limits_rad = "wet_radome", "a film of water on KASHI's radome", ()

    def prepare(self, end):
        return None

    def delay(self, leg, prepared):
        at_kashi = leg.end.per_leg([station.name == "KASHI" for station in leg.end.stations])
        return LegDelay(np.where(at_kashi & leg.end.radio, 0.004, 0.0))


WET_RADOME = WetRadome()
