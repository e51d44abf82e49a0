"""What is checked of the vehicles before the first point (see `engage`). Pure."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Readiness:
    """Which checks are made beyond clocks, receivers, EKF, battery and switch.

    applet: the applet runs, with its stream watchdog; distance: its distance and inset are the
    tool's; reversal: its slot is far enough away for the leader to turn round; sides: no follower's
    way to its slot crosses another's; homes_told: what homes that differ by their receivers mean
    was said; height_told: so was the altitude to fly at; apart_m: warn where the leader comes back
    (RTL) less than this above or below a follower, None: no.
    """

    applet: bool = True
    distance: bool = True
    reversal: bool = True
    sides: bool = True
    homes_told: bool = False
    height_told: bool = False
    apart_m: float | None = None
