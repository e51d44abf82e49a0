"""What was said is not said again too soon."""

from echowing.flight.clocks import SAY_AGAIN_S
from echowing.flight.said import Said


def test_each_thing_is_said_once_in_a_while() -> None:
    said = Said()
    times_s = (0.0, 1.0, SAY_AGAIN_S - 0.1, SAY_AGAIN_S, SAY_AGAIN_S + 1.0)
    assert [said.may_say("low", at_s) for at_s in times_s] == [True, False, False, True, False]


def test_what_is_said_keeps_nothing_else_back() -> None:
    said = Said()
    assert "slow" not in said
    assert said.may_say("low", 0.0) and said.may_say("slow", 0.0)
    assert "slow" in said


def test_how_long_it_waits_is_its_owners() -> None:
    said = Said(again_s=2.0)
    assert [said.may_say("low", at_s) for at_s in (0.0, 1.9, 2.0)] == [True, False, True]
