"""Finds of campaigns, as scenario files: in `finds` those that are open, in `fixed` the others.

Who fixes one moves its file, and it stays fixed.
"""

from pathlib import Path

import pytest

from echowing.campaign.fly import fly_and_judge
from echowing.sim.scenario import load_scenario

pytestmark = pytest.mark.seconds(40)

HERE = Path(__file__).parent
OPEN, FIXED = HERE / "finds", HERE / "fixed"


def broken(path: Path) -> set[str]:
    """The properties that the flight of a file breaks, with the seed at its head."""
    seed = int(path.read_text(encoding="utf-8").partition("--seed ")[2].split()[0])
    return {one.name for one in fly_and_judge(load_scenario(str(path)), seed).broken}


def test_what_was_fixed_stays_fixed() -> None:
    again = {path.name: names for path in sorted(FIXED.glob("*.toml")) if (names := broken(path))}

    assert again == {}


@pytest.mark.long
def test_open_finds_can_be_flown_again() -> None:
    for path in sorted(OPEN.glob("*.toml")):
        assert "crashed" not in broken(path), path.name
