"""The README's animation of a formation: `python -m echowing.docs.film FILE.svg`."""

import sys
from pathlib import Path

from echowing.analysis.animation import write_animation_svg
from echowing.sim.scenario import load_scenario
from echowing.sim.summary import fly

SCENARIO, SEED = "echowing", 1
# One lap of the rectangle, from after the approach: 200 m at 2 m/s.
FROM_S, LAP_S = 20.0, 100.0


def main(path: Path, lap_s: float = LAP_S) -> None:
    """Fly, and write the picture."""
    scenario = load_scenario(SCENARIO, [f"duration_s={FROM_S + lap_s}"])
    (flight,) = fly(scenario, SEED).flights
    speed_mps, radius_m = scenario.leader.speed_mps, scenario.slots()[0].radius_m
    title = f"Simulated: leader at {speed_mps:g} m/s, follower {radius_m:g} m behind"
    write_animation_svg(path, flight, (FROM_S, FROM_S + lap_s), title)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
