"""A sonar that the autopilot reads itself, on a serial port: a MaxBotix fixed to the nose.

ArduPilot's driver of it is the real one (RNGFND1_TYPE 13, AP_RangeFinder_MaxsonarSerialLV.cpp). It
never asks whether anything is there, which is when SITL lets a TCP client in: so this is a line.
"""

import os
import random
import tty

from echowing.sim.world.sonar import LEVER_ARM_M, LONGEST_M, ON_A_DESK, Ear, Pose, Target

from .sonar import Scene, bodies
from .vehicle import Vehicle

RANGEFINDER_TYPE = 13
PERIOD_S = 0.1
# SERIAL2 takes a rangefinder; the sonar tells whole centimetres, and 765 where it hears nothing.
WIRING = {
    "SERIAL2_PROTOCOL": 9.0,
    "RNGFND1_TYPE": float(RANGEFINDER_TYPE),
    "RNGFND1_SCALING": 0.01,
}


class SerialSonar:
    """Tells its autopilot ten times a second what it hears: all within 20 degrees.

    Made before its autopilot, whose SERIAL2 is its `line`; `ride` puts it on the nose.
    """

    def __init__(self) -> None:
        self._end, self._autopilots_end = os.openpty()
        tty.setraw(self._autopilots_end)
        self.line = f"uart:{os.ttyname(self._autopilots_end)}"
        self._ear = Ear(lambda name: random.Random(f"0 {name}"), ON_A_DESK)
        self._follower: Vehicle | None = None

    def ride(self, follower: Vehicle, scene: Scene) -> None:
        """From now on it hears what is there."""
        self._follower, self.scene = follower, scene
        follower.every("sonar", PERIOD_S, lambda: self._ping(follower))

    def _ping(self, follower: Vehicle) -> None:
        if not follower.heard.truth:
            return
        state = follower.state
        legs_m = ON_A_DESK.inset_m - LEVER_ARM_M
        targets = [
            Target(at_m, ON_A_DESK.foil_m, legs_m) for at_m in bodies(state, self.scene(state))
        ]
        pose = Pose((0.0, 0.0, 0.0), (1.0, 0.0, 0.0))
        range_m = self._ear.ping(state.time_s, pose, targets, surfaces=())
        told_cm = round(100.0 * (LONGEST_M if range_m is None else range_m))
        os.write(self._end, f"R{told_cm:03d}\r".encode())

    def close(self) -> None:
        """Pull its plug."""
        if self._follower is not None:
            self._follower.no_more("sonar")
