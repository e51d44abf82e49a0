"""The build-up in flight: the applet's distance first, then the slots, and everything put back."""

import math
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.flight.build_up import SLOT_MPS, TRIES, BuildUp, scaled
from echowing.flight.clocks import ASK_PERIOD_S
from echowing.flight.engage import DIST
from echowing.flight.guidance import GuidanceSettings, Slot
from echowing.flight.orders import HELD, Orders
from echowing.geo import ned_between

from .yard import FOLLOWER, GUIDED, HERE, LEADER, LOITER, SECOND, TICK_S, Vehicle, Yard

RADII_M = (8.0, 5.0, 4.0, 3.0)


class Field(Yard):
    """A yard whose vehicles take PARAM_SET, and an operator with a build-up of `radii_m`."""

    def __init__(
        self,
        radii_m: tuple[float, ...] = RADII_M,
        slots: tuple[Slot, ...] = (Slot(8.0),),
        **yard: Any,
    ) -> None:
        yard.setdefault("vehicles", {LEADER: Vehicle((0.0, 0.0)), FOLLOWER: Vehicle((-8.0, 0.0))})
        super().__init__(slots=slots, **yard)
        self.build_up = BuildUp(radii_m, slots)
        self.orders = Orders(self.session, self.build_up)
        self.deaf = self.forgets = False
        self.radii: list[float] = []

    def fly(self, seconds: float) -> list[Any]:
        points = []
        for _ in range(round(seconds / TICK_S)):
            for system_id, message in self.orders.prepare(self.now_s + TICK_S):
                self._parameters(system_id, message)
            points += super().fly(TICK_S)
            self._flown_to_slots()
            self.radii.append(self.slot(FOLLOWER).radius_m)
        return points

    def _flown_to_slots(self) -> None:
        for system_id, follower in self.session.followers.items():
            if follower.guided is not None and follower.hold is None:
                north_m, east_m, _ = ned_between(HERE, follower.guided.slot)
                self.vehicles[system_id].at_m = north_m, east_m

    def _parameters(self, system_id: int, message: Any) -> None:
        vehicle = self.vehicles[system_id]
        answers = vehicle.answer(message, self.now_s)
        if message.get_type() == "PARAM_SET":
            self.sent.append((system_id, message))
            if self.deaf:
                return
            if not self.forgets:
                vehicle.parameters[DIST] = message.param_value
            real = mavlink.MAV_PARAM_TYPE_REAL32
            answers = [
                mavlink.MAVLink_param_value_message(DIST.encode(), message.param_value, real, 1, 0)
            ]
        for answer in answers:
            self.tell(system_id, answer)

    def tell(self, system_id: int, message: Any, component: int = 1) -> None:
        super().tell(system_id, message, component)
        sender = mavlink.MAVLink(None, srcSystem=system_id, srcComponent=component)
        self.orders.receive(mavlink.MAVLink(None).decode(bytearray(message.pack(sender))))

    def slot(self, system_id: int) -> Slot:
        return self.session.followers[system_id].plan.slot

    def distance(self, system_id: int = FOLLOWER) -> float:
        return self.vehicles[system_id].parameters[DIST]

    def written(self) -> list[float]:
        return [m.param_value for _, m in self.sent if m.get_type() == "PARAM_SET"]


def test_the_slot_comes_nearer_step_by_step_and_the_applets_distance_goes_before_it() -> None:
    field = Field()
    field.fly(3.0)
    assert field.state() == "following"
    assert field.written() == []
    for radius_m, before_m in ((5.0, 8.0), (4.0, 5.0), (3.0, 4.0)):
        field.radii.clear()
        field.orders.nearer(field.now_s)
        field.fly(1.0)
        assert field.distance() == radius_m
        field.fly((before_m - radius_m) / SLOT_MPS + 1.0)
        assert field.radii[0] == pytest.approx(before_m)  # not before it was confirmed
        assert field.radii[-1] == radius_m
        steps = [a - b for a, b in zip(field.radii, field.radii[1:], strict=False)]
        assert max(steps) <= SLOT_MPS * TICK_S + 1e-9
        assert min(steps) >= 0.0
        assert field.said(f"nearer, to {radius_m:g} m by key")
        assert f"radius {radius_m:g} m" in field.events()
    field.orders.nearer(field.now_s)
    assert field.said("not nearer: 3 m is the last radius of --build-up")


@pytest.mark.parametrize("feed_forward", [True, False])
def test_points_with_a_velocity_and_without_follow_and_what_was_learnt_stays(
    feed_forward: bool,
) -> None:
    settings = GuidanceSettings(learn_offset=False, feed_forward=feed_forward)
    field = Field(settings=settings)
    if not feed_forward:
        applet = field.vehicles[FOLLOWER].parameters
        del applet["ECHO_FORMAT"]
        applet["ECHO_LAW"] = 0.0
    field.fly(4.0)
    follower = field.session.followers[FOLLOWER]
    clock, estimate, bar = follower.clock, follower.estimate, follower.guide
    field.orders.nearer(field.now_s)
    field.fly(8.0)
    assert (follower.clock, follower.estimate, follower.guide) == (clock, estimate, bar)
    guided = follower.guided
    assert guided is not None
    north_m, east_m, _ = ned_between(guided.leader, guided.slot)
    assert math.hypot(north_m, east_m) == pytest.approx(5.0, abs=0.05)


def test_backing_out_waits_for_nobody() -> None:
    field = Field()
    field.fly(3.0)
    field.orders.nearer(field.now_s)
    field.fly(8.0)
    field.deaf = True
    field.orders.further(field.now_s)
    field.fly(3.0 / SLOT_MPS + 0.5)
    assert field.radii[-1] == 8.0
    field.fly(TRIES * ASK_PERIOD_S + 1.0)
    assert field.said("follower 2: ECHO_DIST 6 is not confirmed")  # the most that the applet takes
    field.orders.further(field.now_s)
    assert field.said("not further: there is no wider radius")


def test_an_applet_that_does_not_confirm_keeps_everybody_out() -> None:
    field = Field()
    field.fly(3.0)
    field.deaf = True
    field.orders.nearer(field.now_s)
    field.fly(TRIES * ASK_PERIOD_S + 2.0)
    assert set(field.radii) == {8.0}
    assert field.said("follower 2: ECHO_DIST 5 is not confirmed")
    assert field.said("the radius stays 8 m")


def test_an_applet_that_says_yes_and_keeps_its_own_keeps_everybody_out() -> None:
    field = Field()
    field.fly(3.0)
    field.forgets = True
    field.orders.nearer(field.now_s)
    field.fly(TRIES * ASK_PERIOD_S + 2.0)
    assert set(field.radii) == {8.0}
    assert field.said("follower 2: ECHO_DIST 5 is not confirmed")


def test_what_asks_for_nearer_is_refused_while_somebody_holds_or_is_under_way() -> None:
    field = Field(engaged=False)
    field.fly(3.0)
    assert field.orders.objection_to_nearer(field.now_s) == "not engaged"
    field.orders.engage(field.now_s)
    field.fly(2.0)
    field.orders.hold(field.now_s)
    field.fly(1.0)
    assert field.orders.objection_to_nearer(field.now_s) == "not engaged"
    field.orders.engage(field.now_s)
    field.vehicles[LEADER].silent = True
    field.fly(2.0)
    objection = "follower 2 holds: leader is stale"
    assert field.orders.objection_to_nearer(field.now_s) == objection
    field.vehicles[LEADER].silent = False
    field.fly(2.0)
    field.orders.nearer(field.now_s)
    field.fly(2.0)
    assert field.orders.objection_to_nearer(field.now_s) == "still on the way to 5 m"


def test_nearer_than_a_leader_that_turns_round_allows_is_refused_as_before_engaging() -> None:
    field = Field((8.0, 5.0, 3.0))
    parameters = field.vehicles[FOLLOWER].parameters
    parameters["WP_ACC"], parameters["PSC_JERK_NE"] = 2.5, 5.0  # ArduCopter's defaults: 4.6 m
    field.fly(3.0)
    field.orders.nearer(field.now_s)
    field.fly(8.0)
    assert field.radii[-1] == 5.0
    field.orders.nearer(field.now_s)
    field.fly(2.0)
    assert field.radii[-1] == 5.0
    assert field.said("not nearer: follower 2: its slot is 3 m from the leader, and 4.6 m is the")


def test_a_formation_keeps_its_shape() -> None:
    slots = (Slot(8.0, math.radians(40.0)), Slot(12.0, math.radians(-40.0), 1.0))
    vehicles = {
        LEADER: Vehicle((0.0, 0.0)),
        FOLLOWER: Vehicle((-6.1, 5.1)),
        SECOND: Vehicle((-9.2, -7.7)),
    }
    field = Field((8.0, 4.0), slots, vehicles=vehicles)
    field.fly(3.0)
    field.orders.nearer(field.now_s)
    field.fly(1.0)
    assert (field.distance(), field.distance(SECOND)) == (4.0, 6.0)
    field.radii.clear()
    field.fly(16.0)
    assert [field.slot(one) for one in (FOLLOWER, SECOND)] == scaled(slots, 4.0)
    assert field.slot(SECOND).radius_m == pytest.approx(6.0)
    # The outermost slot, which has the longer way, keeps the rate.
    fastest_m = max(a - b for a, b in zip(field.radii, field.radii[1:], strict=False))
    assert fastest_m == pytest.approx(SLOT_MPS * TICK_S * 8.0 / 12.0)


def test_the_applets_distance_is_put_back_at_the_end() -> None:
    field = Field()
    field.vehicles[FOLLOWER].parameters[DIST] = 3.5
    field.fly(3.0)
    field.orders.nearer(field.now_s)
    field.fly(8.0)
    assert field.distance() == 5.0
    # Who ends the tool by force has to put it back himself.
    told = "follower 2: ECHO_DIST was 3.5 and is put back at the end"
    assert field.events().count(told) == 1
    field.build_up.restore()
    field.fly(1.0)
    assert field.distance() == 3.5
    assert field.build_up.restored
    assert field.build_up.left() == [("follower 2: ECHO_DIST put back to 3.5", True)]


def test_an_end_without_an_answer_says_how_to_put_it_back() -> None:
    field = Field()
    field.fly(3.0)
    field.orders.nearer(field.now_s)
    field.fly(8.0)
    field.deaf = True
    field.build_up.restore()
    field.fly(TRIES * ASK_PERIOD_S + 1.0)
    assert field.build_up.left() == [
        ("follower 2: ECHO_DIST NOT put back: param set ECHO_DIST 3", False)
    ]


def test_what_somebody_else_has_set_meanwhile_is_his() -> None:
    field = Field()
    field.fly(3.0)
    field.orders.nearer(field.now_s)
    field.fly(8.0)
    field.vehicles[FOLLOWER].parameters[DIST] = 4.5
    real = mavlink.MAV_PARAM_TYPE_REAL32
    field.tell(FOLLOWER, mavlink.MAVLink_param_value_message(DIST.encode(), 4.5, real, 1, 0))
    field.build_up.restore()
    field.fly(2.0)
    assert field.distance() == 4.5
    assert field.build_up.left() == []


def test_nothing_is_written_where_it_is_right_already() -> None:
    field = Field((8.0, 3.0))
    field.fly(3.0)
    field.orders.nearer(field.now_s)
    field.fly(11.0)
    assert field.radii[-1] == 3.0
    assert field.written() == []


# ---- the operator's other orders ----------------------------------------------------------------


def test_engaging_by_key_sends_points_and_a_hold_ends_by_the_same_key() -> None:
    field = Field(engaged=False)
    assert field.fly(3.0) == []
    field.orders.engage(field.now_s)
    assert field.fly(1.0) != []
    assert field.state() == "following"
    field.orders.hold(field.now_s)
    field.fly(1.0)
    assert field.state() == f"holding: {HELD}"
    field.orders.engage(field.now_s)
    field.fly(1.0)
    assert field.state() == "following"
    texts = [m.text for who, m in field.sent if who == FOLLOWER and m.get_type() == "STATUSTEXT"]
    assert texts == [
        "Echowing: engaged by its operator",
        f"Echowing: holding, {HELD}",
        "Echowing: clear again, following",
    ]


def test_a_hold_outlasts_the_pilots_change_of_mode() -> None:
    field = Field()
    field.fly(3.0)
    field.orders.hold(field.now_s)
    for mode in (LOITER, GUIDED):
        field.vehicles[FOLLOWER].mode = mode
        field.fly(2.0)
    assert field.state() == f"holding: {HELD}"


def test_a_hold_that_ends_frees_nobody_who_is_held_for_another_reason() -> None:
    field = Field()
    field.fly(3.0)
    field.session.followers[
        FOLLOWER
    ].turn.latched = "leader jumped by 12.0 m, until it leaves Guided"
    field.orders.hold(field.now_s)
    field.fly(1.0)
    field.orders.engage(field.now_s)
    field.fly(1.0)
    assert field.state().startswith("holding: leader jumped")


def test_a_stop_is_for_good() -> None:
    field = Field()
    field.fly(3.0)
    field.orders.stop(field.now_s)
    field.orders.engage(field.now_s)
    field.fly(2.0)
    assert field.state() == "holding: stopped by the operator"
    assert field.said("all were stopped: end this tool and start it anew to engage")
