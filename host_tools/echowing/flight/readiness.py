"""What is checked of the vehicles before the first point (see `engage`). Pure."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Readiness:
    """Which checks are made beyond clocks, receivers, EKF, battery and switch.

    applet: the applet runs that flies these points, with its stream watchdog; any_applet: whichever
    applet it is; distance: its distance and inset are the
    tool's; reversal: its slot is far enough away for the leader to turn round; sides: no follower's
    way to its slot crosses another's; homes_told: the operator has said what a difference between
    the homes means; height_told: and at which altitude to fly; apart_m: warn where the leader
    returns (RTL) less than this above or below a follower, None: no warning.
    """

    applet: bool = True
    any_applet: bool = False
    distance: bool = True
    reversal: bool = True
    sides: bool = True
    homes_told: bool = False
    height_told: bool = False
    apart_m: float | None = None
