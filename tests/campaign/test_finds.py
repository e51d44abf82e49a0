"""Finds of campaigns, as scenario files: in `finds` those that are open, in `fixed` the others.

Who fixes one moves its file, and it stays fixed.
"""

from pathlib import Path

import pytest

from echowing.campaign.fly import fly_and_judge
from echowing.sim.scenario import load_scenario

pytestmark = pytest.mark.seconds(10)

HERE = Path(__file__).parent
OPEN, FIXED = HERE / "finds", HERE / "fixed"
# A sonar that is wrong, a follower that is pushed by another, and one that moved when stopped: of
# each kind the one that is flown soonest.
SOONEST = [
    FIXED / f"{name}.toml"
    for name in (
        "stuck-sonar-moves-the-leader",
        "pushed-into-the-leader",
        "pulled-back-under-its-switch",
    )
]


def broken(path: Path) -> set[str]:
    """The properties that the flight of a file breaks, with the seed at its head."""
    seed = int(path.read_text(encoding="utf-8").partition("--seed ")[2].split()[0])
    return {one.name for one in fly_and_judge(load_scenario(str(path)), seed).broken}


@pytest.mark.parametrize(
    "path",
    [
        *SOONEST,
        *(
            pytest.param(path, marks=pytest.mark.long)
            for path in sorted(set(FIXED.glob("*.toml")) - set(SOONEST))
        ),
    ],
    ids=lambda path: path.stem,
)
def test_what_was_fixed_stays_fixed(path: Path) -> None:
    assert broken(path) == set()


@pytest.mark.long
def test_open_finds_can_be_flown_again() -> None:
    for path in sorted(OPEN.glob("*.toml")):
        assert "crashed" not in broken(path), path.name
