"""A sonar that the autopilot reads itself, on a serial port: a MaxBotix fixed to the nose.

ArduPilot's driver of it is the real one (RNGFND1_TYPE 13, AP_RangeFinder_MaxsonarSerialLV.cpp). It
never asks whether anything is there, which is when SITL lets a TCP client in: so this is a line.
"""

import contextlib
import os
import random
import tty

from echowing.sim.world.sonar import LONGEST_M, Ear, Pose, Target

from .sonar import Scene, bodies, silence
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
        os.set_blocking(self._end, False)
        self.line = f"uart:{os.ttyname(self._autopilots_end)}"
        self._ear = Ear(lambda name: random.Random(f"0 {name}"))
        self.scene: Scene = silence

    def ride(self, follower: Vehicle) -> None:
        """From now on it tells what is heard in its scene."""
        self._follower = follower
        follower.every("sonar", PERIOD_S, self._ping)

    def _ping(self) -> None:
        if not self._follower.heard.truth:
            return
        state = self._follower.state
        targets = [Target(at_m) for at_m in bodies(state, self.scene(state))]
        pose = Pose((0.0, 0.0, 0.0), (1.0, 0.0, 0.0))
        range_m = self._ear.ping(state.time_s, pose, targets, surfaces=())
        told_cm = round(100.0 * (LONGEST_M if range_m is None else range_m))
        with contextlib.suppress(BlockingIOError):  # nobody has read for a minute
            os.write(self._end, f"R{told_cm:03d}\r".encode())

    def close(self) -> None:
        """Pull its plug; its autopilot has ended, or misses it."""
        self._follower.no_more("sonar")

    def end(self) -> None:
        """Close the line."""
        os.close(self._end)
        os.close(self._autopilots_end)
