"""What was read and received from a vehicle: everything that the checks use."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum

from echowing.applets import HOLD, Applet
from echowing.flight.belief import SonarBelief
from echowing.setup.boards import Board, board_of
from echowing.sonar_file import MAVLINK_TYPE, shipped_sonar


class Role(Enum):
    """The vehicle's role; it decides what the vehicle needs."""

    FOLLOWER = "follower"
    LEADER = "leader"


class CardApplet(Enum):
    """Which applet is on the autopilot's card."""

    OURS = "ours"
    ANOTHER = "another"  # version
    NONE = "none"
    OTHER = "other"  # only one that shall not run
    SEVERAL = "several"  # one applet would stop the other


@dataclass(frozen=True, slots=True)
class Reports:
    """The co-processor's DISTANCE_SENSOR messages of some seconds, as they arrived here.

    A radio loses some: the true rate may be higher, and the longest gap shorter.
    """

    count: int
    heard_for_s: float
    longest_gap_s: float
    orientation: int
    sensor_id: int

    @property
    def rate_hz(self) -> float:
        """Messages per second."""
        return self.count / self.heard_for_s if self.heard_for_s > 0.0 else 0.0


@dataclass(frozen=True, slots=True)
class Readout:
    """One vehicle at one time.

    parameters: of the autopilot, those of the requested ones that it has. serial_port: the SERIALn
    to which the co-processor is wired, if the operator has given it. rangefinder: the number of
    RNGFNDn. coprocessor: its component id, None if it does not report; coprocessor_status its
    MAV_STATE. takes_range: whether the autopilot itself reports a forward range, None if it was
    not asked. in_guided: armed and in Guided, so that an enabled applet is in control and reports.
    applet_on_card: None if the autopilot does not answer file requests. objections: why the
    autopilot would not arm, in its own words. signs: whether it signs its messages, and so accepts
    only signed ones. range_type: the RNGFNDn_TYPE that it shall have: 10, MAVLink, or that of the
    autopilot's own driver, which needs no co-processor. applet: the one that it shall run; sonar:
    what is believed of the one that it carries; sonar_named: the operator has named its file to
    `apply`, so that the applet shall be told what it says. board_id: as AUTOPILOT_VERSION tells it.
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
    range_type: int = MAVLINK_TYPE
    applet: Applet = HOLD
    sonar: SonarBelief = field(default_factory=shipped_sonar)
    sonar_named: bool = False
    board_id: int | None = None

    def first(self, *names: str) -> tuple[str, float] | None:
        """The first of these parameters that the vehicle has, with its value."""
        return next(((name, self.parameters[name]) for name in names if name in self), None)

    @property
    def fixed(self) -> bool:
        """Whether its autopilot reads the sensor itself."""
        return self.range_type != MAVLINK_TYPE

    @property
    def board(self) -> Board | None:
        """The autopilot's board; None: not known."""
        return board_of(self.board_id)

    def __contains__(self, name: str) -> bool:
        """Whether the vehicle has this parameter."""
        return name in self.parameters
