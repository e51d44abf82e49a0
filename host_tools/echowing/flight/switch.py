"""The stop switches of a session: on, off or unseen, and whom they stop. Pure.

A follower that a switch has stopped stays stopped until its pilot has left Guided and come back.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.errors import EchowingError
from echowing.flight.clocks import REBOOT_S
from echowing.mavlink.messages import command_long

# Modes that a stop switch may choose. STABILIZE is none: a low throttle stick drops the vehicle.
SWITCH_MODES = {
    "LOITER": mavlink.COPTER_MODE_LOITER,
    "BRAKE": mavlink.COPTER_MODE_BRAKE,
    "LAND": mavlink.COPTER_MODE_LAND,
    "RTL": mavlink.COPTER_MODE_RTL,
}
# What ArduPilot takes as a pulse of a receiver; 0 means that there is none.
VALID_PULSE_US = range(801, 2200)
CHANNELS = 18  # of RC_CHANNELS
# Asked for at 4 Hz: a switch that has not been reported for so long is not known.
SWITCH_FRESH_S = 3.0
# A mode, and the heartbeat before it, are requested again after this time.
MODE_PERIOD_S = 0.5


@dataclass(frozen=True, slots=True)
class StopSwitch:
    """A switch on a transmitter: on above `pwm_us`; `mode`: what to change to, None: just stop."""

    channel: int
    pwm_us: int
    mode: str | None = None

    def pulse_us(self, message: Any) -> int:
        """The channel's pulse in an RC_CHANNELS; 0: none."""
        return int(getattr(message, f"chan{self.channel}_raw"))


def parse_stop_switch(text: str) -> StopSwitch:
    """`CH:PWM[:MODE]`, as `5:1200` or `7:1700:LOITER`. Raises EchowingError."""
    channel, _, rest = text.partition(":")
    pwm, _, mode = rest.partition(":")
    if not channel.isdecimal() or not 1 <= int(channel) <= CHANNELS:
        raise EchowingError(f"stop switch {text!r}: the channel is a number from 1 to {CHANNELS}")
    if not pwm.isdecimal() or int(pwm) not in VALID_PULSE_US:
        raise EchowingError(f"stop switch {text!r}: the pulse is a number from 801 to 2199 us")
    if mode.upper() == "STABILIZE":
        raise EchowingError(
            f"stop switch {text!r}: STABILIZE is refused, since a low throttle stick drops the "
            f"vehicle; take {', '.join(SWITCH_MODES)}, or no mode to stop in Guided"
        )
    if mode and mode.upper() not in SWITCH_MODES:
        raise EchowingError(f"stop switch {text!r}: the mode is one of {', '.join(SWITCH_MODES)}")
    return StopSwitch(int(channel), int(pwm), mode.upper() or None)


@dataclass(slots=True)
class _Seen:
    """A vehicle's newest RC_CHANNELS with a pulse in it."""

    on: bool | None = None
    boot_ms: int = -1
    at_s: float = -math.inf


@dataclass(slots=True)
class _Stopped:
    """A follower that a switch has stopped.

    since_s: since when, None: it is not; asked_at_s, taken_at_s: when its mode was last asked
    for, and when a change of mode was last acknowledged; beat_asked_at_s: when a heartbeat was.
    """

    since_s: float | None = None
    asked_at_s: float = -math.inf
    taken_at_s: float = -math.inf
    beat_asked_at_s: float = -math.inf


class Switches:
    """The switch of the leader, which stops all, and of each follower; `switch` None: no switch."""

    def __init__(
        self, switch: StopSwitch | None, leader_id: int, follower_ids: Iterable[int]
    ) -> None:
        self.switch = switch
        self._leader_id = leader_id
        self._stopped = {system_id: _Stopped() for system_id in follower_ids}
        self._seen = {system_id: _Seen() for system_id in (leader_id, *self._stopped)}

    def receive(self, system_id: int, message: Any, now_s: float) -> None:
        """Take an RC_CHANNELS; one older than the newest, or without a pulse, is ignored."""
        if self.switch is None:
            return
        seen, pulse_us = self._seen[system_id], self.switch.pulse_us(message)
        older = 0 < seen.boot_ms - message.time_boot_ms <= 1000.0 * REBOOT_S
        if pulse_us not in VALID_PULSE_US or older:
            return
        seen.on = pulse_us > self.switch.pwm_us
        seen.boot_ms, seen.at_s = message.time_boot_ms, now_s
        if seen.on:
            self._stop(list(self._stopped) if system_id == self._leader_id else [system_id], now_s)

    def _stop(self, system_ids: Iterable[int], now_s: float) -> None:
        for system_id in system_ids:
            stopped = self._stopped[system_id]
            stopped.since_s = now_s if stopped.since_s is None else stopped.since_s

    def entered_guided(self, system_id: int, now_s: float) -> None:
        """The pilot has put a follower in Guided: only a switch that is on now stops it."""
        self._stopped[system_id] = _Stopped()
        if self._seen[system_id].on or self._seen[self._leader_id].on:
            self._stop([system_id], now_s)

    def stops(self, system_id: int) -> bool:
        """Whether a switch has stopped this follower since it was put in Guided."""
        return self._stopped[system_id].since_s is not None

    def shown(self, system_id: int, now_s: float) -> str | None:
        """A vehicle's switch in a word, for the view; None: there is no switch."""
        if self.switch is None:
            return None
        seen = self._seen[system_id]
        if seen.on is None or now_s - seen.at_s > SWITCH_FRESH_S:
            return "not seen"
        latched = system_id in self._stopped and self.stops(system_id)
        return "on" if seen.on else "was on" if latched else "off"

    # ---- its mode -------------------------------------------------------------------------------

    def mode_answered(self, system_id: int, message: Any, now_s: float) -> None:
        """Take a COMMAND_ACK for us: a mode that was accepted is not requested twice.

        The pilot may have chosen another since; the next heartbeat shows it.
        """
        taken = message.result == mavlink.MAV_RESULT_ACCEPTED
        if taken and message.command == mavlink.MAV_CMD_DO_SET_MODE:
            self._stopped[system_id].taken_at_s = now_s

    def message(
        self, system_id: int, heartbeat_at_s: float, round_trip_s: float, now_s: float
    ) -> Any | None:
        """What to send to a follower that the tool moves: its mode, or a request for it.

        The mode goes only to a vehicle whose heartbeat has said Guided since the switch stopped it:
        a fail-safe may have changed it since the last one, and must not be overridden.
        """
        stopped, switch = self._stopped[system_id], self.switch
        if switch is None or switch.mode is None or stopped.since_s is None:
            return None
        known_since_s = max(stopped.since_s, stopped.asked_at_s + round_trip_s, stopped.taken_at_s)
        if heartbeat_at_s > known_since_s and now_s - stopped.asked_at_s >= MODE_PERIOD_S:
            stopped.asked_at_s = stopped.beat_asked_at_s = now_s
            return set_mode(system_id, SWITCH_MODES[switch.mode])
        if now_s - stopped.beat_asked_at_s < MODE_PERIOD_S:
            return None
        stopped.beat_asked_at_s = now_s
        ask, what = mavlink.MAV_CMD_REQUEST_MESSAGE, mavlink.MAVLINK_MSG_ID_HEARTBEAT
        return command_long(system_id, ask, what)


def set_mode(system_id: int, mode: int) -> Any:
    """Ask a vehicle to change its mode."""
    custom = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
    return command_long(system_id, mavlink.MAV_CMD_DO_SET_MODE, custom, mode)
