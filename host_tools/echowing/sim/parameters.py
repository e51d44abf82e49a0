"""Parameters of the simulated autopilot: names, units and defaults by ArduCopter generation."""

from enum import Enum


class Generation(Enum):
    """A released line of ArduCopter; what differs between them is names and units only."""

    V4_5 = "4.5"
    V4_6 = "4.6"
    V4_7 = "4.7"
    V4_8 = "4.8"
