"""Which reports are believed, and what becomes of a follower meanwhile."""

import pytest

from echowing.flight.guidance import GuidanceSettings
from echowing.flight.jumps import AGREEING_REPORTS, SAME_RANGE_M, UNCONFIRMED_S
from echowing.flight.steps import Hold
from echowing.flight.trust import Trust
from echowing.geo import ned_between

from .told import HEIGHT_M, Told, at
from .yard import FOLLOWER, LEADER, TICK_S, Vehicle

FAR_M = 5.0


class Trusted(Told):
    """Two that hover 3 m apart, and what is thought of their reports."""

    def __init__(self, *, strict: bool = True, refuses: bool = True) -> None:
        vehicles = {LEADER: Vehicle((0.0, 0.0)), FOLLOWER: Vehicle((-3.0, 0.0))}
        super().__init__(vehicles, settings=GuidanceSettings())
        self.follower.in_guided = True
        self.refused: list[int] = []
        refuse = self._refuse if refuses else None
        self.trust = Trust(self.known, self.tell, self.tell, refuse, strict=strict)
        self.fly(1.0)
        self.said.clear()

    def _refuse(self, system_id: int, text: str, now_s: float) -> None:
        self.refused.append(system_id)

    def fly(self, seconds: float) -> None:
        """Both report at each tick."""
        for _ in range(round(seconds / TICK_S)):
            self.now_s += TICK_S
            self.trust.leader_reported(self.position(LEADER), self.now_s)
            report = self.follower.reported(self.position(FOLLOWER), self.now_s)
            assert report is not None
            self.trust.follower_reported(self.follower, report)
            self.trust.settle(self.follower, self.now_s)

    def jump(self, system_id: int, north_m: float = FAR_M) -> None:
        before_m, east_m = self.vehicles[system_id].at_m
        self.vehicles[system_id].at_m = before_m + north_m, east_m

    def was_said(self, text: str) -> int:
        """How often."""
        return sum(text in str(one) for one in self.said)


def test_vehicles_that_hover_are_believed_and_nothing_is_said() -> None:
    there = Trusted()
    there.fly(5.0)
    assert there.said == []
    assert there.follower.turn.latched is None


@pytest.mark.parametrize(("who", "seen_m"), [(LEADER, 1.0), (FOLLOWER, -1.0)])
def test_a_receiver_that_drifts_does_not_move_its_vehicle(who: int, seen_m: float) -> None:
    """A metre in eight seconds, while the vehicle says that it stands, and no sonar hears."""
    there = Trusted()
    for _ in range(round(8.0 / TICK_S)):
        there.jump(who, 0.125 * TICK_S)
        there.fly(TICK_S)

    assert there.follower.estimate.drifted_m == pytest.approx((seen_m, 0.0), abs=0.1)
    fix = there.known.leader.fix
    assert fix is not None and there.follower.position is not None
    to_it_m = ned_between(
        there.follower.position, there.known.as_seen_by(there.follower, fix.position)
    )
    assert to_it_m[0] == pytest.approx(3.0, abs=0.1)


@pytest.mark.parametrize("who", [LEADER, FOLLOWER])
@pytest.mark.parametrize("far_m", [1.6, 2.5, 15.0])
def test_a_jump_is_no_drift_as_well(who: int, far_m: float) -> None:
    """The sonar shows whether it is the receiver's; it must not count twice."""
    there = Trusted()
    there.jump(who, far_m)
    there.fly(4.0)

    assert there.follower.estimate.drifted_m == pytest.approx((0.0, 0.0), abs=0.1)


def test_its_own_jump_holds_it_once_the_sonar_has_had_time_to_deny_it() -> None:
    there = Trusted()
    there.jump(FOLLOWER)
    there.fly(UNCONFIRMED_S - 2.0 * TICK_S)
    assert there.follower.turn.latched is None
    there.fly(3.0 * TICK_S)
    assert there.follower.turn.latched == "its position jumped by 5.0 m, until it leaves Guided"
    assert there.was_said("follower 2: its receiver jumped by 5.0 m") == 1


def test_a_jump_of_one_that_its_pilot_flies_latches_nothing() -> None:
    there = Trusted()
    there.follower.in_guided = False
    there.jump(FOLLOWER)
    there.fly(UNCONFIRMED_S + 1.0)
    assert there.follower.turn.latched is None
    assert there.said == []


def test_a_jump_and_back_is_none() -> None:
    there = Trusted()
    there.jump(FOLLOWER)
    there.fly(0.5)
    there.jump(FOLLOWER, -FAR_M)
    there.fly(UNCONFIRMED_S + 1.0)
    assert there.follower.turn.latched is None


def test_a_hold_stands_where_it_stood_when_its_receiver_jumps() -> None:
    there = Trusted()
    there.follower.hold = Hold(at(-3.0), HEIGHT_M)
    there.jump(FOLLOWER)
    there.fly(1.0)
    held = there.follower.hold
    assert held is not None
    assert held.place.lat_deg == pytest.approx(at(-3.0 + FAR_M).lat_deg, abs=1e-6)


def test_a_leader_that_jumps_is_said_at_once_and_holds_all_once_it_is_believed_there() -> None:
    there = Trusted()
    there.jump(LEADER)
    there.fly(TICK_S)
    assert there.was_said("leader jumps: not believed") == 1
    assert there.known.leader.fix is not None
    assert there.known.leader.fix.position.lat_deg == pytest.approx(at(0.0).lat_deg, abs=1e-6)
    assert there.follower.turn.latched is None
    there.fly((AGREEING_REPORTS + 1) * TICK_S)
    assert there.follower.turn.latched == "leader jumped by 5.0 m, until it leaves Guided"
    assert there.was_said("leader jumps: not believed") == 1
    assert there.was_said("agree 5.0 m away") == 1


def test_without_limits_a_leader_is_followed_to_its_new_place() -> None:
    there = Trusted(strict=False, refuses=False)
    there.jump(LEADER)
    there.fly((AGREEING_REPORTS + 2) * TICK_S)
    assert there.follower.turn.latched is None
    assert there.said == []
    assert there.known.leader.fix is not None
    assert there.known.leader.fix.position.lat_deg == pytest.approx(at(FAR_M).lat_deg, abs=1e-6)


@pytest.mark.parametrize("twice", [LEADER, FOLLOWER])
def test_reports_that_come_in_turn_from_two_places_are_of_two_vehicles(twice: int) -> None:
    there = Trusted()
    for number in range(40):
        there.jump(twice, 60.0 if number % 2 == 0 else -60.0)
        there.now_s += TICK_S
        there.trust.is_sure(twice, there.position(twice), there.now_s)
    assert there.refused == [twice]
    assert there.was_said(f"two vehicles with id {twice}") == 1
    assert (there.follower.turn.latched is not None) is (twice == LEADER)


def test_a_small_jump_is_said_and_latches_nothing() -> None:
    """What two receivers may wander apart anyway."""
    there = Trusted()
    there.follower.own_jump.since_s = there.now_s
    there.follower.own_jump.moved_m = (0.9 * SAME_RANGE_M, 0.0)
    there.fly(UNCONFIRMED_S + 1.0)
    assert there.follower.turn.latched is None
