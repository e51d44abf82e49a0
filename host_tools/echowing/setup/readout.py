"""What has been read and heard of a vehicle: all that the checks go by."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum


class Role(Enum):
    """What a vehicle is to do: what it needs hangs on it."""

    FOLLOWER = "follower"
    LEADER = "leader"


class CardApplet(Enum):
    """Which applet is on the autopilot's card."""

    OURS = "ours"
    ANOTHER = "another"
    NONE = "none"


@dataclass(frozen=True, slots=True)
class Reports:
    """The co-processor's DISTANCE_SENSOR messages of some seconds, as they came here.

    Over a radio some are lost: the rate is the least it can be, the longest gap the most.
    """

    count: int
    heard_for_s: float
    longest_gap_s: float
    orientation: int
    sensor_id: int

    @property
    def rate_hz(self) -> float:
        """Messages a second."""
        return self.count / self.heard_for_s if self.heard_for_s > 0.0 else 0.0


@dataclass(frozen=True, slots=True)
class Readout:
    """One vehicle at one time.

    parameters: of the autopilot, those it has of the ones asked for. serial_port: the SERIALn the
    co-processor is wired to, where the operator has said so. rangefinder: which RNGFNDn is meant.
    coprocessor: its component id, None where it is not heard; coprocessor_status its MAV_STATE.
    takes_range: whether the autopilot itself tells a forward range, None where it was not asked.
    in_guided: armed and in Guided, where an enabled applet is in control and heard. applet_on_card:
    None where the autopilot does not answer file requests. objections: why the autopilot would not
    arm, in its own words. signs: whether it signs what it sends, and so believes only what is
    signed.
    """

    parameters: Mapping[str, float]
    serial_port: int | None = None
    rangefinder: int = 1
    armed: bool = False
    version: tuple[int, int] | None = None
    coprocessor: int | None = None
    coprocessor_status: int | None = None
    coprocessor_parameters: Mapping[str, float] = field(default_factory=dict)
    reports: Reports | None = None
    takes_range: bool | None = None
    in_guided: bool = False
    applet_heard: bool = False
    applet_on_card: CardApplet | None = None
    objections: Sequence[str] = ()
    signs: bool = False

    def first(self, *names: str) -> tuple[str, float] | None:
        """The first of these parameters that the vehicle has, with its value."""
        return next(((name, self.parameters[name]) for name in names if name in self), None)

    def __contains__(self, name: str) -> bool:
        """Whether the vehicle has this parameter."""
        return name in self.parameters
