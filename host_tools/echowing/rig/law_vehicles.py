"""The vehicle whose speed applet reads the bench's sonar: built in, or a real autopilot."""

import time
from collections.abc import Callable, Mapping
from typing import Any, Protocol

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.applets import SPEED
from echowing.errors import EchowingError
from echowing.mavlink.messages import TOOL_COMPONENT_ID, TOOL_SYSTEM_ID
from echowing.rig.law_steps import Law, Sample
from echowing.rig.messages import Frames, source_of
from echowing.rig.ports import open_wire
from echowing.rig.readings import named_value
from echowing.setup.applet import applet_path

LAW_PARAMETERS = (
    *("ECHO_LAW", "ECHO_DIST", "ECHO_INSET", "ECHO_BAND_IN", "ECHO_BAND_OUT", "ECHO_DETECT"),
    *("ECHO_STEP_SML", "ECHO_STEP_BIG", "ECHO_PERIOD", "ECHO_SPD_MIN", "ECHO_SPD_MAX"),
)
ANSWER_S = 1.0
TRIES = 3
HEARTBEAT_S = 1.0
FIND_S = 5.0  # an autopilot beats once per second


class LawVehicle(Protocol):
    """Runs the applet on the board's reports."""

    name: str

    def law(self) -> Law:
        """The law's parameters; EchowingError when it is not law 0."""

    def in_control(self) -> bool:
        """Whether the applet sets the speed now."""

    def idle(self) -> None:
        """Nothing is measured yet: drop its messages."""

    def hear(self, message: Any) -> None:
        """Take a message of the board."""

    def advance(self, now_s: float) -> list[Sample]:
        """Run until now; returns the samples since the last call."""

    def close(self) -> None:
        """Let go."""


def law_of(parameters: Mapping[str, float | None]) -> Law:
    """The law of these applet parameters; EchowingError if it is another law, or none."""
    missing = [name for name in LAW_PARAMETERS if parameters.get(name) is None]
    if missing:
        raise EchowingError(
            f"the autopilot has no parameter {missing[0]}: is the speed applet on its SD card "
            "(`echowing setup lua --applet speed`) and SCR_ENABLE 1?"
        )
    # Six digits: what was written as 3.05 comes back as 3.0499999 in 32 bits.
    known = {name: float(f"{value:.6g}") for name, value in parameters.items() if value is not None}
    if known["ECHO_LAW"] != 0.0:
        raise EchowingError(
            f"ECHO_LAW is {known['ECHO_LAW']:g}: Table 6 is law 0; set it to 0 for this test, "
            "and back afterwards"
        )
    return Law.of(known)


def is_guarded(law: Law, speed_mps: float) -> bool:
    """Whether the applet's too-close guard sets the speed: law 0 never reaches its limits."""
    return not law.least_mps + 1e-3 < speed_mps < law.most_mps - 1e-3


class BuiltInVehicle:
    """The applet's own file on the simulated autopilot, armed in Guided and hovering."""

    name = "the built-in Lua host"
    STEP_S = 0.02  # as the simulator flies it: the applet runs every 50 ms
    BEGIN_S = 0.4  # the applet is in control by then, and does not yet miss its sonar

    def __init__(self, system_id: int) -> None:
        from echowing.sim.vehicle.autopilot import Autopilot  # noqa: PLC0415 (large)
        from echowing.sim.vehicle.copter import Copter  # noqa: PLC0415

        self._copter = Copter((0.0, 0.0, -10.0), 0.0, flying=True)
        parameters = {
            **{"RNGFND1_TYPE": 10.0, "RNGFND1_ORIENT": 0.0, "SCR_ENABLE": 1.0},
            **{"ECHO_ENABLE": 1.0, "ECHO_LAW": 0.0},
        }
        self._autopilot = Autopilot(self._copter, system_id=system_id, parameters=parameters)
        self._autopilot.add_link("board")
        self._autopilot.load_script(applet_path(SPEED))
        self._start_s: float | None = None
        self._steps = 0
        while self._steps * self.STEP_S < self.BEGIN_S:
            self._step()
        self._law = self.law()

    def law(self) -> Law:
        """As `LawVehicle`."""
        return law_of({name: self._autopilot.parameter_get(name) for name in LAW_PARAMETERS})

    def in_control(self) -> bool:
        """As `LawVehicle`: it begins armed."""
        return True

    def idle(self) -> None:
        """As `LawVehicle`: its time stands still."""

    def hear(self, message: Any) -> None:
        """As `LawVehicle`."""
        self._autopilot.receive("board", bytes(message.get_msgbuf()))

    def advance(self, now_s: float) -> list[Sample]:
        """As `LawVehicle`."""
        if self._start_s is None:
            self._start_s = now_s - self._steps * self.STEP_S
        samples = []
        while (self._steps + 1) * self.STEP_S <= now_s - self._start_s:
            self._step()
            samples.append(self._sample(self._start_s + self._steps * self.STEP_S))
        return samples

    def _step(self) -> None:
        self._steps += 1
        self._copter.step(self.STEP_S)
        self._autopilot.step(self._steps * self.STEP_S)
        self._autopilot.transmit("board")
        script = self._autopilot.script
        if script is None or script.error:
            raise EchowingError(f"the applet has stopped: {script.error if script else 'not run'}")

    def _sample(self, t_s: float) -> Sample:
        from echowing.sim.vehicle.rangefinder import GOOD, OUT_OF_RANGE_LOW  # noqa: PLC0415

        seen = self._autopilot.rangefinder_status(0) in (GOOD, OUT_OF_RANGE_LOW)
        range_m = round(self._autopilot.rangefinder_distance_m(0), 4) if seen else None
        speed_mps = self._autopilot.parameter_get("WP_SPD") or 0.0
        return Sample(t_s, range_m, speed_mps, is_guarded(self._law, speed_mps))

    def close(self) -> None:
        """As `LawVehicle`."""


class AutopilotVehicle:
    """An autopilot (or SITL) with the applet and the board on it, on a link of its own.

    Nothing is set on it: the operator arms it in Guided, propellers off.
    """

    def __init__(self, where: str, baud: int, clock: Callable[[], float] = time.monotonic) -> None:
        self.name = f"the autopilot on {where}"
        self._clock = clock
        self._wire = open_wire(where, baud)
        self._frames = Frames()
        self._mav = mavlink.MAVLink(None, srcSystem=TOOL_SYSTEM_ID, srcComponent=TOOL_COMPONENT_ID)
        self._heartbeat_s = -HEARTBEAT_S
        self._values: dict[str, float] = {}
        self._samples: list[Sample] = []
        self._law: Law | None = None
        self._system_id = self._find()

    def _find(self) -> int:
        deadline_s = self._clock() + FIND_S
        while self._clock() < deadline_s:
            for message in self._read(0.1):
                if _is_autopilot(message):
                    return int(message.get_srcSystem())
        raise EchowingError(f"{self.name}: no autopilot has reported there for {FIND_S:g} s")

    def _read(self, timeout_s: float) -> list[Any]:
        # ArduPilot tells its named floats only where it has heard somebody.
        if self._clock() - self._heartbeat_s >= HEARTBEAT_S:
            self._heartbeat_s = self._clock()
            self._send(
                mavlink.MAVLink_heartbeat_message(
                    mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 0, 3
                )
            )
        messages = self._frames.parse(self._wire.read(timeout_s), self._clock())
        if messages:
            self._wire.understood()
        return messages

    def _send(self, message: Any) -> None:
        self._wire.write(message.pack(self._mav))
        self._mav.seq = (self._mav.seq + 1) % 256

    def law(self) -> Law:
        """As `LawVehicle`."""
        self._law = law_of({name: self._parameter(name) for name in LAW_PARAMETERS})
        return self._law

    def _parameter(self, name: str) -> float | None:
        for _ in range(TRIES):
            self._send(
                mavlink.MAVLink_param_request_read_message(self._system_id, 1, name.encode(), -1)
            )
            deadline_s = self._clock() + ANSWER_S
            while self._clock() < deadline_s:
                for message in self._read(deadline_s - self._clock()):
                    if message.get_type() == "PARAM_VALUE" and message.param_id == name:
                        return float(message.param_value)
        return None

    def in_control(self) -> bool:
        """As `LawVehicle`."""
        return bool(self._values.get("ECHO_STATE"))

    def idle(self) -> None:
        """As `LawVehicle`."""
        self.advance(self._clock())

    def hear(self, message: Any) -> None:
        """As `LawVehicle`: it has its own wire to the board."""

    def advance(self, now_s: float) -> list[Sample]:
        """As `LawVehicle`."""
        for message in self._read(0.0):
            if source_of(message) == (self._system_id, mavlink.MAV_COMP_ID_AUTOPILOT1):
                self._note(message)
        samples, self._samples = self._samples, []
        return samples

    def _note(self, message: Any) -> None:
        """The applet tells range, speed and state together, the state last."""
        named = named_value(message)
        if named is None or not named[0].startswith("ECHO_"):
            return
        self._values[named[0]] = named[1]
        if named[0] != "ECHO_STATE" or self._law is None or len(self._values) < 3:
            return
        # Centre to centre as the applet has it; 0: no target.
        range_m = round(self._values["ECHO_RNG"] - self._law.inset_m, 4)
        in_range = 0.0 < range_m < self._law.detect_m
        speed_mps = round(self._values["ECHO_SPD"], 4)
        guarded = is_guarded(self._law, speed_mps)
        self._samples.append(
            Sample(message._timestamp, range_m if in_range else None, speed_mps, guarded)
        )

    def close(self) -> None:
        """As `LawVehicle`."""
        self._wire.close()


def _is_autopilot(message: Any) -> bool:
    return bool(
        message.get_type() == "HEARTBEAT"
        and message.get_srcComponent() == mavlink.MAV_COMP_ID_AUTOPILOT1
        and message.autopilot != mavlink.MAV_AUTOPILOT_INVALID
    )
