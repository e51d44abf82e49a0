"""What differs between ArduCopter's versions as far as the suite sets or reads it.

A vehicle is asked which of the names it has; the version alone would be wrong for what is built
between two releases.
"""

from dataclasses import dataclass

from echowing.sim.vehicle.parameters import Generation, dialect_of


@dataclass(frozen=True, slots=True)
class Version:
    """A firmware version, as AUTOPILOT_VERSION says it."""

    major: int
    minor: int
    patch: int

    @classmethod
    def unpack(cls, packed: int) -> "Version":
        """From `flight_sw_version`: a byte each, then the type of release."""
        return cls(packed >> 24 & 0xFF, packed >> 16 & 0xFF, packed >> 8 & 0xFF)

    @property
    def line(self) -> str:
        """The released line, "4.8"."""
        return f"{self.major}.{self.minor}"

    @property
    def generation(self) -> str:
        """The generation of the built-in simulator that stands for it: the nearest that it has."""
        known = [generation.value for generation in Generation]
        return min(known, key=lambda one: abs(int(one.partition(".")[2]) - self.minor))


# Each with the factor from SI to the parameter's unit, newest name first.
Names = dict[str, float]

_NEW, _OLD = dialect_of(Generation.V4_8), dialect_of(Generation.V4_6)

SPEED: Names = {_NEW.speed: 1.0 / _NEW.speed_scale, _OLD.speed: 1.0 / _OLD.speed_scale}
ACCELERATION: Names = {"WP_ACC": 1.0, "WPNAV_ACCEL": 100.0}
DRIFT_NORTH: Names = {"SIM_GPS1_GLTCH_X": 1.0, "SIM_GPS_GLITCH_X": 1.0}
DRIFT_EAST: Names = {"SIM_GPS1_GLTCH_Y": 1.0, "SIM_GPS_GLITCH_Y": 1.0}
OFF_NORTH: Names = {"SIM_GPS1_VERR_X": 1.0, "SIM_GPS_VERR_X": 1.0}
OFF_EAST: Names = {"SIM_GPS1_VERR_Y": 1.0, "SIM_GPS_VERR_Y": 1.0}
DRIFT_UP = "SIM_BARO_GLITCH"  # in all of them
# From the north, and full near the ground: by default 6 m/s at 60 m are 2.4 m/s at 10 m.
WIND_SPEED = "SIM_WIND_SPD"
WIND = {"SIM_WIND_DIR": 0.0, "SIM_WIND_T": 1.0, "SIM_WIND_TURB": 0.0}
SPEEDUP: Names = {"SIM_SPEEDUP": 1.0}
