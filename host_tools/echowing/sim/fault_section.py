"""Timed faults of a scenario, `[[fault]]`: which there are, and what each is told."""

from typing import Annotated, Literal

from pydantic import Field, model_validator

from echowing.geo import Ned
from echowing.section import NotNegative, Positive, Section, Share

FaultKind = Literal[
    "autopilot_rebooted",
    "bytes_lost",
    "coprocessor_off",
    "coprocessor_reset",
    "gps_jump",
    "gps_lost",
    "home_differs",
    "late_echoes",
    "leader_attacks",
    "leader_climbs",
    "leader_reverses",
    "leader_stops",
    "narrow_beam",
    "north_south_offset",
    "outage",
    "pilot_takes_over",
    "script_killed",
    "servo_jammed",
    "sonar_dead",
    "sonar_stuck",
    "sonar_unplugged",
    "sonar_wild",
    "stop_switch",
    "tool_killed",
    "tool_stopped",
]

LEADER = 1
LEADER_FAULTS = {"leader_attacks", "leader_climbs", "leader_reverses", "leader_stops"}
FORMATION_FAULTS = {"north_south_offset", "tool_killed", "tool_stopped"}
ANY_VEHICLES_FAULTS = {"bytes_lost", "gps_jump", "gps_lost", "home_differs", "outage"}
ANY_VEHICLES_FAULTS |= {"stop_switch"}
# The values that a kind takes beside its times and its vehicle; all others are refused for it.
_VALUES = {
    "bytes_lost": {"byte_loss", "link", "way"},
    "gps_jump": {"jump_ned_m"},
    "home_differs": {"height_m"},
    "late_echoes": {"range_m"},
    "leader_attacks": {"speed_mps"},
    "leader_climbs": {"climb_mps"},
    "leader_reverses": {"speed_mps"},
    "narrow_beam": {"half_angle_deg"},
    "outage": {"way"},
    "pilot_takes_over": {"mode"},
}
_ALL_VALUES = set().union(*_VALUES.values())
# These come once and are over.
_MOMENTS = {"coprocessor_reset", "tool_stopped"}
# Without these the kind says nothing.
_NEEDED = {"gps_jump": "jump_ned_m", "home_differs": "height_m", "late_echoes": "range_m"}
_NEEDED |= {
    "bytes_lost": "byte_loss",
    "narrow_beam": "half_angle_deg",
    "leader_climbs": "climb_mps",
}
_LASTING = {"home_differs", "north_south_offset"}


class FaultSection(Section):
    """One fault: what, from when on, for how long, on which vehicle (see `echowing.sim.faults`)."""

    kind: FaultKind
    """Which fault."""
    at_s: NotNegative = 0.0
    """When it begins."""
    for_s: Positive | None = None
    """How long it lasts; none: to the end."""
    vehicle: Annotated[int, Field(ge=1)] | None = None
    """On which vehicle: 1 is the leader, 2 the first follower."""
    way: Literal["both", "down", "up"] = "both"
    """Of `outage` and `bytes_lost`: from the autopilot (`down`), to it (`up`), or both."""
    link: Literal["radio", "wire"] = "radio"
    """Of `bytes_lost`: the vehicle's radio, or the wire to its co-processor."""
    byte_loss: Share = 0.0
    """Of `bytes_lost`: share of the packets lost, as in `[radio.leader]`."""
    jump_ned_m: Ned = (0.0, 0.0, 0.0)
    """Of `gps_jump`: north, east, down."""
    speed_mps: Positive = 1.0
    """Of `leader_attacks` and `leader_reverses`."""
    climb_mps: float = 0.0
    """Of `leader_climbs`; negative: it descends."""
    height_m: float = 0.0
    """Of `home_differs`: so much higher by its receiver."""
    range_m: Positive = 8.0
    """Of `late_echoes`: to what reflects."""
    half_angle_deg: Annotated[float, Field(gt=0.0, le=90.0)] = 20.0
    """Of `narrow_beam`: half its width."""
    mode: Literal["STABILIZE", "ALT_HOLD", "LOITER", "POSHOLD", "BRAKE", "RTL", "LAND"] = "LOITER"
    """Of `pilot_takes_over`: the mode that the pilot takes."""

    @model_validator(mode="after")
    def _makes_sense(self) -> "FaultSection":
        given = self.model_fields_set
        foreign = sorted(given & (_ALL_VALUES - _VALUES.get(self.kind, set())))
        if foreign:
            raise ValueError(f"{self.kind} takes no {', '.join(foreign)}")
        needed = _NEEDED.get(self.kind)
        if needed is not None and needed not in given:
            raise ValueError(f"{self.kind} needs `{needed}`")
        if self.kind in _MOMENTS and self.for_s is not None:
            raise ValueError(f"{self.kind} is over at once: leave out for_s")
        if self.kind in _LASTING and (self.at_s != 0.0 or self.for_s is not None):
            raise ValueError(f"{self.kind} is so from the start: leave out at_s and for_s")
        return self._on_the_right_vehicle()

    def _on_the_right_vehicle(self) -> "FaultSection":
        if self.kind in LEADER_FAULTS | FORMATION_FAULTS:
            if self.vehicle not in (None, LEADER) or (
                self.vehicle == LEADER and self.kind in FORMATION_FAULTS
            ):
                raise ValueError(f"{self.kind} is not a follower's: leave out vehicle")
        elif self.vehicle is None:
            raise ValueError(f"{self.kind} needs `vehicle`: 1 is the leader, 2 the first follower")
        elif self.vehicle == LEADER and self.kind not in ANY_VEHICLES_FAULTS:
            raise ValueError(f"{self.kind} is a follower's: vehicle is 2 or more")
        if self.vehicle == LEADER and self.link == "wire":
            raise ValueError("the leader has no co-processor: link is radio")
        return self

    @property
    def ends_s(self) -> float:
        """When it is over; infinity: never."""
        if self.kind in _MOMENTS:
            return self.at_s
        return float("inf") if self.for_s is None else self.at_s + self.for_s

    @property
    def told(self) -> str:
        """What it is, in words."""
        who = {None: "", LEADER: "leader: "}.get(self.vehicle, f"follower {self.vehicle}: ")
        values = sorted(_VALUES.get(self.kind, set()) & self.model_fields_set)
        told = ", ".join(f"{name} {_plain(getattr(self, name))}" for name in values)
        return f"{who}{self.kind.replace('_', ' ')}" + (f" ({told})" if told else "")


def _plain(value: object) -> str:
    if isinstance(value, tuple):
        return "(" + ", ".join(f"{one:g}" for one in value) + ")"
    return f"{value:g}" if isinstance(value, float) else str(value)


def objection(faults: tuple[FaultSection, ...], followers: int, duration_s: float) -> str | None:
    """What is wrong with the faults of one scenario together; None: nothing."""
    for number, fault in enumerate(faults):
        if fault.vehicle is not None and fault.vehicle > 1 + followers:
            return f"fault {number + 1}: no vehicle {fault.vehicle}; the last is {1 + followers}"
        if fault.at_s >= duration_s:
            return f"fault {number + 1}: at_s ({fault.at_s:g}) is after the flight's end"
        for before, other in enumerate(faults[:number]):
            if _clash(fault, other):
                return (
                    f"faults {before + 1} and {number + 1}: {fault.kind} twice at a time; "
                    "move one of them"
                )
    return None


def _clash(one: FaultSection, other: FaultSection) -> bool:
    """Whether two faults of a kind on one vehicle overlap; so do any two things a leader does."""
    both_leaders = one.kind in LEADER_FAULTS and other.kind in LEADER_FAULTS
    same = one.kind == other.kind and one.vehicle == other.vehicle
    apart = one.at_s > other.ends_s or other.at_s > one.ends_s
    return (same or both_leaders) and not apart
