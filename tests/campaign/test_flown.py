"""Flights of the shipped campaign, with a fixed seed: three, and forty in `make test-long`."""

import pytest

from echowing.campaign.draw import load_description
from echowing.campaign.fly import CRASHED, LOGS, Row, fly_one
from echowing.campaign.properties import BLOWN, BLOWN_ON, MISLED

pytestmark = pytest.mark.seconds(15)

SEED = 1
# Two of the forty came too near when this was written: in 2 a receiver jumps and the sonar is
# unplugged, in 26 receivers disagree by 5.5 m, more than anything allows for, and the leader is
# never heard. One more may on another machine: a flight amplifies the last digit.
MOST_TOO_NEAR = {3: 0, 40: 3}
# Two followers whose tool dies; one with faults of receiver, sonar, applet and leader; one with a
# wild sonar. None comes near to what is too near.
FEW = (0, 5, 6)
SEPARATION = "separation"
# No law can help it: the wind has taken all the lean that there is.
OF_THE_WIND = {BLOWN, BLOWN_ON}
TOO_NEAR = {SEPARATION, MISLED}


@pytest.fixture(
    scope="module", params=[FEW, pytest.param(range(40), marks=pytest.mark.long)], ids=len
)
def rows(request: pytest.FixtureRequest) -> list[Row]:
    description = load_description()
    return [fly_one(description, SEED, index) for index in request.param]


def test_no_flight_breaks_a_promise_but_for_the_known_share_that_comes_too_near(
    rows: list[Row],
) -> None:
    broken = {row["index"]: {one["name"] for one in row["broken"]} - OF_THE_WIND for row in rows}
    too_near = [index for index, names in broken.items() if TOO_NEAR & names]

    assert {index: names - TOO_NEAR for index, names in broken.items() if names - TOO_NEAR} == {}
    assert len(too_near) <= MOST_TOO_NEAR[len(rows)], too_near


def test_every_flight_ends_and_its_logs_are_read(rows: list[Row]) -> None:
    names = {one["name"] for row in rows for one in row["broken"]}

    assert not names & {CRASHED, LOGS}


def test_what_was_wrong_was_in_force(rows: list[Row]) -> None:
    kinds = {kind for row in rows for kind in row["faults"]}
    flown = {kind for row in rows for kind in row["in_force_s"]}

    assert kinds
    assert kinds <= flown
