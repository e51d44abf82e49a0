"""A leader that is not where the receivers say is found by the gimbal, from the slot."""

import time

from .formation import rectangle, rest
from .plugin import Start
from .table import Entry, Figures

# The leader is 1.0 m further north of the follower than the receivers say, all the time.
SEED = 558
SPEED_MPS = 2.0
FOUND_S, AFTER_S = 10.0, 10.0  # on the first leg, to the north
HOLDING = 7.0  # ECHO_STATE
LEAST_M = 1.0


def test_search(start: Start, table: list[Entry]) -> None:
    formation = start(SEED, wandering=False)
    formation.leader.upload(rectangle(formation), 10.0)
    formation.take_off()
    tool = formation.follow()
    tool.wait_for(lambda line: '"following"' in line)
    began_s = time.monotonic()
    formation.leader.fly_mission(SPEED_MPS)
    applet = formation.follower.heard.named
    formation.follower.until(
        "found its leader", lambda: applet.get("ECHO_STATE") == HOLDING, within_s=FOUND_S
    )
    found_s = time.monotonic() - began_s
    rest(AFTER_S)
    least_m = formation.least_m(began_s, time.monotonic())
    note = "; ".join(filter(None, [f"found after {found_s:.0f} s", formation.note(began_s)]))
    entry = Entry(formation.kit.version.line, "search", Figures(least_m=least_m), note=note)
    table.append(entry)
    assert least_m >= LEAST_M
