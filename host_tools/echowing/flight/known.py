"""What is known of the leader and its followers, every value with its time. Pure.

The first step of a tick: messages come in here, and every later step reads from here.
"""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace

from echowing.flight.alignment import History
from echowing.flight.cloud import UNRANGED_SIGMA_M, UNRANGED_UP_SIGMA_M, Off, Wandering
from echowing.flight.envelope import SURE_SIGMAS
from echowing.flight.estimate import LONGEST_CARRY_S, Beside, Estimate, Tie, carried_on
from echowing.flight.follower import FollowerPlan, FollowerState
from echowing.flight.guidance import (
    GuidanceSettings,
    Horizontal,
    LeaderFix,
    Slot,
    bearing_rad,
    is_stale,
    place_m,
    predicted,
)
from echowing.flight.handling import leader_brakes_mps2
from echowing.flight.homes import Homes
from echowing.flight.leader_track import LeaderTrack, VehicleClock, report_of
from echowing.flight.tail import TailSlot
from echowing.flight.ties import Link, errors
from echowing.flight.tow_bar import TowBar
from echowing.geo import GlobalPosition, Ned, displace, ned_between

# By their reports two vehicles may be so much further apart than in truth: 2.8 m by what receivers
# may be off (`SURE_SIGMAS`), 1.5 m by what they fly in a second, until the next report
# (`plan.JOIN_MPS`).
REPORTS_M = 4.3
# Of how far the one ahead is off its slot, so much counts for the next slot: 0.4 after four.
FLOWN_SHARE = 0.8

# The followers of a way down from another, and of the way on up.
_Way = tuple[list[FollowerState], list[FollowerState]]


class Known:
    """The leader and its followers as they are known now."""

    def __init__(
        self,
        leader_id: int,
        plans: Iterable[FollowerPlan],
        settings: GuidanceSettings,
        homes: Homes | None = None,
    ) -> None:
        plans = list(plans)
        self.leader_id = leader_id
        self.settings = settings
        self.leader = LeaderTrack()
        self.leader_history = History()
        self.leader_mode: int | None = None
        self.homes = homes or Homes(leader_id)
        self.in_height = self.homes.in_height
        self.followers = {
            plan.system_id: FollowerState(
                plan,
                TowBar(plan.slot) if settings.tow_bar else TailSlot(plan.slot),
                Estimate(plan.sonar),
            )
            for plan in plans
        }
        place_guides(self.followers.values())
        self._ahead = {
            plan.system_id: self.followers[plans[plan.slot.behind].system_id]
            for plan in plans
            if plan.slot.behind is not None
        }
        self._ways: dict[tuple[int, int], _Way] = {}

    def clock(self, system_id: int) -> VehicleClock | None:
        """The clock of one of these vehicles; None: of a stranger."""
        if system_id == self.leader_id:
            return self.leader.clock
        follower = self.followers.get(system_id)
        return follower.clock if follower else None

    @property
    def leader_brakes_mps2(self) -> float:
        """How hard the leader may brake and turn round in its mode."""
        return leader_brakes_mps2(self.leader_mode)

    def leader_age_s(self, at_s: float) -> float:
        """How old the newest report of the leader is at a moment."""
        return math.inf if self.leader.fix is None else max(0.0, at_s - self.leader.fix.time_s)

    def leader_is_stale(self, now_s: float) -> bool:
        """Whether it is so old that nobody may be led by it."""
        return is_stale(self.leader_age_s(now_s), self.settings)

    def ahead_of(self, follower: FollowerState) -> FollowerState | None:
        """The follower that one's sonar looks at; None: it looks at the leader."""
        return self._ahead.get(follower.plan.system_id)

    def is_watched(self, follower: FollowerState) -> bool:
        """Whether another follower's sonar looks at it."""
        return bool(self.behind(follower))

    def behind(self, ahead: FollowerState | None) -> list[FollowerState]:
        """Those whose sonars look at a follower; None: at the leader."""
        return [one for one in self.followers.values() if self.ahead_of(one) is ahead]

    def watch(self, ahead: Mapping[int, FollowerState | None]) -> None:
        """Let followers' sonars look at these vehicles, by follower; None: the leader.

        What the sonars between a follower and that vehicle have told of the receivers stays known.
        """
        changed = {
            system_id: one
            for system_id, one in ahead.items()
            if one is not self.ahead_of(self.followers[system_id])
        }
        ties = {
            system_id: self._tie(self.followers[system_id], one)
            for system_id, one in changed.items()
        }
        for system_id, one in changed.items():
            self._ahead.pop(system_id, None)
            if one is not None:
                self._ahead[system_id] = one
            self.followers[system_id].turn_to(ties[system_id], self._history_of(one))
        if changed:
            self._ways.clear()

    def _tie(self, follower: FollowerState, other: FollowerState | None) -> Tie:
        """What is known of a follower's and another one's receivers; other None: the leader's."""
        mine, its = list(self.chain(follower)), list[FollowerState]()
        if other is not None:
            mine, its = self._way_between(follower, other)
        of_mine, of_its = ([one.estimate.offset.off for one in way] for way in (mine, its))
        off = _off(of_mine, of_its)
        if off.level_sigma_m >= UNRANGED_SIGMA_M:
            off = off._replace(north_m=0.0, east_m=0.0, level_sigma_m=UNRANGED_SIGMA_M)
        off = off._replace(up_sigma_m=min(UNRANGED_UP_SIGMA_M, off.up_sigma_m))
        jumped = _summed(*([one.estimate.jumped_m for one in way] for way in (mine, its)))
        proven = _summed(*([one.proven_m for one in way] for way in (mine, its)))
        return Tie(off, (jumped[0], jumped[1]), (proven[0], proven[1]))

    def expect(self, follower: FollowerState) -> None:
        """Begin the search for whom its sonar looks at with what the others' sonars tell."""
        offset, links = follower.estimate.offset, self._links()
        if not links:
            return
        found = errors([self.leader_id, *self.followers], links, Wandering().sigma_m)
        own_id, its_id = follower.plan.system_id, self.watched_id(follower)
        north_m, east_m, sigma_m = found.between(its_id, own_id)
        offset.turn_to(Off(north_m, east_m, offset.up_m, sigma_m, offset.up_sigma_m))

    def _links(self) -> list[Link]:
        """What each sonar tells that has heard whom it looks at."""
        offsets = [(one, one.estimate.offset) for one in self.followers.values()]
        return [
            Link(
                one.plan.system_id,
                self.watched_id(one),
                offset.north_m,
                offset.east_m,
                offset.level_sigma_m,
            )
            for one, offset in offsets
            if offset.has_heard
        ]

    def take(self, slots: Mapping[int, Slot]) -> None:
        """Give followers these slots, by system id; a slot is `behind` a follower's number.

        A slot on its way into another shape has its radius there (see `FollowerState.slot`).
        """
        everybody = list(self.followers.values())
        for system_id, slot in slots.items():
            self.followers[system_id].plan.slot = slot
        self.watch(
            {
                system_id: None if slot.behind is None else everybody[slot.behind]
                for system_id, slot in slots.items()
            }
        )
        place_guides(everybody)

    def move_up(self, line: Sequence[FollowerState]) -> None:
        """Give each of a line the slot of the one before it, and the first one the last one's.

        A slot is behind the same other slot as before, whoever flies there.
        """
        takes = {
            had.plan.system_id: has for had, has in zip(line, (*line[1:], line[0]), strict=True)
        }
        numbers = {system_id: number for number, system_id in enumerate(self.followers)}
        slots = {}
        for system_id, had in self.followers.items():
            one = takes.get(system_id, had)
            ahead = self.ahead_of(had)
            ahead = ahead and takes.get(ahead.plan.system_id, ahead)
            behind = None if ahead is None else numbers[ahead.plan.system_id]
            slots[one.plan.system_id] = replace(had.plan.slot, behind=behind)
        self.take(slots)

    def chain(self, follower: FollowerState) -> Iterator[FollowerState]:
        """A follower, the one its sonar looks at, and so on up to the one behind the leader."""
        one: FollowerState | None = follower
        while one is not None:
            yield one
            one = self.ahead_of(one)

    def as_seen_by(self, follower: FollowerState, place: GlobalPosition) -> GlobalPosition:
        """A place by the leader's receiver in a follower's frame."""
        if not self.settings.learn_offset:
            return place
        for one in self.chain(follower):
            place = one.estimate.as_seen(place)
        return place

    def seen_by(self, follower: FollowerState, fix: LeaderFix) -> LeaderFix:
        """A report of the leader in this follower's frame."""
        return replace(fix, position=self.as_seen_by(follower, fix.position))

    def watched_then(self, follower: FollowerState, at_s: float) -> LeaderFix | None:
        """The vehicle its sonar looks at, at a moment, in its frame; None: nothing is known."""
        ahead = self.ahead_of(follower)
        if ahead is None:
            return self.leader_then(follower, at_s)
        there = ahead.then(at_s)
        if there is None:
            return None
        if self.settings.learn_offset:
            there = follower.estimate.as_seen(there)
        velocity = (*ahead.velocity_then(at_s), -ahead.climb_mps)
        return LeaderFix(ahead.position_at_s, there, velocity, ahead.heading_rad)

    def followed_then(self, follower: FollowerState, fix: LeaderFix, at_s: float) -> LeaderFix:
        """What its slot is behind, at a moment, in its frame: the leader, or another slot.

        That slot's velocity, so that nobody amplifies another's; nearly the place of who flies in
        it, as its sonar sees that one: a step from one to the other, where the sonar loses him, is
        flown with full lean.
        """
        ahead = self.ahead_of(follower)
        if ahead is None:
            then = self.leader_then(follower, at_s) if self.settings.predict else None
            return then or self.seen_by(follower, fix)
        place, velocity_mps, heading_rad = _slot_then(ahead, at_s)
        if place is None:
            return self.watched_then(follower, at_s) or self.seen_by(follower, fix)
        place = _towards(place, ahead.then(at_s))
        place = place._replace(alt_m=place.alt_m - ahead.plan.slot.altitude_step_m)
        if self.settings.learn_offset:
            place = follower.estimate.as_seen(place)
        return LeaderFix(fix.time_s, place, (*velocity_mps, 0.0), heading_rad)

    def formation_mps(self, fix: LeaderFix, at_s: float) -> Horizontal | None:
        """The leader's velocity at a moment, (north, east); None: it has one follower only."""
        if len(self.followers) == 1:
            return None
        return carried_on(fix, at_s).velocity_ned_mps[:2]

    def apart(
        self, follower: FollowerState, other: FollowerState, there: GlobalPosition
    ) -> tuple[GlobalPosition, float]:
        """Where another follower's own report `there` is in this one's frame.

        And the standard deviation of that. What sonars know of the receivers on the way from one to
        the other, over those that they look at, is used where it is more than is known without.
        """
        if not self.settings.learn_offset:
            return there, UNRANGED_SIGMA_M
        mine, its = self._way_between(follower, other)
        sigma_m = self.sigma_m((*mine, *its))
        if sigma_m >= UNRANGED_SIGMA_M:
            return there, UNRANGED_SIGMA_M
        north_m, east_m = _summed(*([one.estimate.shift_m for one in way] for way in (its, mine)))
        return displace(there, (north_m, east_m, 0.0)), sigma_m

    def _way_between(self, follower: FollowerState, other: FollowerState) -> _Way:
        """Over whose sonars it goes: up to what both chains share, this one's and the other's."""
        ends = follower.plan.system_id, other.plan.system_id
        if ends not in self._ways:
            mine, its = (
                {one.plan.system_id: one for one in self.chain(end)} for end in (follower, other)
            )
            self._ways[ends] = (
                [one for system_id, one in mine.items() if system_id not in its],
                [one for system_id, one in its.items() if system_id not in mine],
            )
        return self._ways[ends]

    def _beside(self, follower: FollowerState) -> Iterator[Beside]:
        """The vehicles near a follower that its sonar may hear instead of whom it looks at."""
        ahead, fix = self.ahead_of(follower), self.leader.fix
        if fix is None:
            return
        if ahead is not None and _may_hear(follower, fix.position):
            off = _off((), [one.estimate.off for one in self.chain(ahead)])
            yield Beside(self.leader_id, self.leader_history, off)
        for other in self.followers.values():
            there = other.position
            if other is follower or other is ahead or there is None:
                continue
            if not _may_hear(follower, there):
                continue
            mine, its = self._way_between(follower, other)
            # Of one behind this follower its own sonar tells, not this one's.
            links = [one for one in mine if one is not follower]
            yield Beside(
                other.plan.system_id,
                other.estimate.history,
                _off(*([one.estimate.off for one in way] for way in (its, links))),
                moves=len(links) < len(mine),
            )

    def sigma_m(self, links: Iterable[FollowerState]) -> float:
        """Standard deviation of what is known over the sonars of these followers."""
        return math.sqrt(sum(one.estimate.offset.level_sigma_m**2 for one in links))

    def leader_sigma_m(self, follower: FollowerState) -> float:
        """The same of where it sees the leader: no more than receivers alone leave."""
        return min(UNRANGED_SIGMA_M, self.sigma_m(self.chain(follower)))

    def leader_then(self, follower: FollowerState, at_s: float) -> LeaderFix | None:
        """The leader at a moment, in this follower's frame; None: nothing is known of it."""
        fix = self.leader.fix
        if fix is None or self.leader_age_s(at_s) > LONGEST_CARRY_S:
            return None
        return carried_on(self.seen_by(follower, fix), at_s)

    def leader_for(self, follower: FollowerState, fix: LeaderFix, now_s: float) -> GlobalPosition:
        """Where the leader is now, in the frame of this follower's receiver."""
        now = predicted(fix, max(0.0, now_s - fix.time_s)).position
        return self.as_seen_by(follower, now)

    def watched_id(self, follower: FollowerState) -> int:
        """The system that its sonar looks at."""
        ahead = self.ahead_of(follower)
        return self.leader_id if ahead is None else ahead.plan.system_id

    def watched_now(self, follower: FollowerState, now_s: float) -> GlobalPosition | None:
        """Where whom its sonar looks at is, in its frame; None: not known, or no more."""
        fix = self.leader.fix
        if self.ahead_of(follower) is not None:
            watched = self.watched_then(follower, now_s)
            return None if watched is None else watched.position
        if fix is None or self.leader_is_stale(now_s):
            return None
        return self.leader_for(follower, fix, now_s)

    def bearing_of_watched(self, follower: FollowerState, now_s: float) -> float | None:
        """Bearing from a follower to whom its sonar looks at; None: one of them is not known."""
        watched, here = self.watched_then(follower, now_s), follower.then(now_s)
        return None if watched is None or here is None else bearing_rad(here, watched.position)

    def watched_above_m(self, follower: FollowerState) -> float:
        """How much higher than a follower the one its sonar looks at is; 0: that is not known."""
        ahead, here = self.ahead_of(follower), follower.position
        fix = self.leader.fix
        there = ahead.position if ahead is not None else None if fix is None else fix.position
        if there is None or here is None:
            return 0.0
        above = self.in_height(self.watched_id(follower), there)
        return above.alt_m - self.in_height(follower.plan.system_id, here).alt_m

    def nearest_m(self, follower: FollowerState, to_it_m: Horizontal, clear_m: float) -> float:
        """How near a follower may come to whom its sonar looks at (`Cloud.nearest_m`).

        to_it_m: (north, east) from the follower.
        """
        above_m = self.watched_above_m(follower)
        return follower.estimate.offset.nearest_m(to_it_m, above_m, clear_m)

    def nearer_m(self, follower: FollowerState, to_it_m: Horizontal, clear_m: float) -> float:
        """By how much whom its sonar looks at may be nearer than it is believed."""
        return max(0.0, self.nearest_m(follower, to_it_m, clear_m) - clear_m)

    def seen(
        self,
        follower: FollowerState,
        here: GlobalPosition,
        other: FollowerState,
        there: GlobalPosition,
        clear_m: float,
    ) -> tuple[GlobalPosition, float]:
        """Where another follower is in this one's frame; by how much it may be nearer than that."""
        seen, sigma_m = self.apart(follower, other, there)
        unsure_m = SURE_SIGMAS * sigma_m
        north_m, east_m, _ = ned_between(here, seen)
        if self.ahead_of(follower) is other:
            unsure_m = min(unsure_m, self.nearer_m(follower, (north_m, east_m), clear_m))
        elif self.ahead_of(other) is follower:
            unsure_m = min(unsure_m, self.nearer_m(other, (-north_m, -east_m), clear_m))
        return seen, unsure_m

    def from_it_m(
        self, system_id: int, there: GlobalPosition, follower: FollowerState, here: GlobalPosition
    ) -> Ned:
        """From another vehicle to a follower that is here, heights by what is known of homes."""
        mine = self.in_height(follower.plan.system_id, here)
        return ned_between(self.in_height(system_id, there), mine)

    def least_room_m(
        self, follower: FollowerState, clear_m: float, now_s: float
    ) -> tuple[FollowerState, float, float] | None:
        """The other follower that is least certain to leave room, of those whose place is known.

        How far away it is, heights included, and by how much it may be nearer. None: there is none.
        """
        here = follower.then(now_s)
        found: list[tuple[FollowerState, float, float]] = []
        for other in self.followers.values():
            there = other.then(now_s) or other.left_at
            if other is follower or here is None or there is None:
                continue
            seen, unsure_m = self.seen(follower, here, other, there, clear_m)
            from_it_m = self.from_it_m(other.plan.system_id, seen, follower, here)
            found.append((other, math.hypot(*from_it_m), unsure_m))
        return min(found, key=lambda one: one[1] - one[2], default=None)

    def doubted_m(self, follower: FollowerState) -> Horizontal:
        """How far off a follower sees the leader, (north, east), if all jumps were errors."""
        north_m, east_m = _summed([self.unsettled_m(one) for one in self.chain(follower)], ())
        return north_m, east_m

    def unsettled_m(self, follower: FollowerState) -> Horizontal:
        """The same of whom its sonar looks at.

        The jumps of both receivers, less those that the sonar has settled.
        """
        ahead, estimate = self.ahead_of(follower), follower.estimate
        its_m = self.leader.total_m if ahead is None else ahead.own_jump.total_m
        mine_m = follower.own_jump.total_m, estimate.jumped_m
        north_m, east_m = _summed(mine_m, (its_m, follower.proven_m))
        return north_m, east_m

    def feel_wind(self, follower: FollowerState, now_s: float) -> None:
        """How hard a follower can brake in this wind, on its way to the leader."""
        bearing = self.bearing_of_watched(follower, now_s)
        if bearing is not None:
            handling = follower.handling
            leaves_mps2 = follower.wind.leaves_mps2(bearing, handling.lean_max_rad)
            handling.wind_leaves_mps2 = leaves_mps2

    def note_leader(self, fix: LeaderFix) -> None:
        """Keep a new report of the leader, and let every estimate learn from it."""
        place = self.in_height(self.leader_id, fix.position)
        drifted_m = self.leader.drift.lately_m
        self.leader_history.add(replace(report_of(fix), position=place, drifted_m=drifted_m))
        if self.settings.learn_offset:
            for follower in self.followers.values():
                watched = self._history_of(self.ahead_of(follower))
                follower.estimate.learn(watched, list(self._beside(follower)))

    def _history_of(self, follower: FollowerState | None) -> History:
        """A follower's reports; None: the leader's."""
        return self.leader_history if follower is None else follower.estimate.history


def place_guides(followers: Iterable[FollowerState]) -> None:
    """Hang each follower's slot, as it is now, on its bar.

    In a line each bar turns as its slot comes to the corner. Side by side they turn as one body, as
    long as the whole formation: on shorter ones those on the inside of a corner would fly back.
    """
    followers = list(followers)
    slots = [one.plan.slot for one in followers]
    in_line = all(one.angle_rad == 0.0 for one in slots)
    body_m = max(math.hypot(*place_m(slots, number)[:2]) for number in range(len(slots)))
    for one, slot in zip(followers, slots, strict=True):
        beside_m = (other.radius_m for other in slots if other.behind == slot.behind)
        one.guide.place(slot, max(beside_m) if in_line else body_m)


def _may_hear(follower: FollowerState, there: GlobalPosition) -> bool:
    """Whether its sonar may reach a vehicle that reports to be there."""
    here, sonar = follower.position, follower.plan.sonar
    if here is None:
        return False
    return math.hypot(*ned_between(here, there)[:2]) < sonar.reach_m + sonar.inset_m + REPORTS_M


def _off(over: Sequence[Off], back_over: Sequence[Off]) -> Off:
    """What the ends of a way over sonars disagree by: up over some, down again over others."""
    north_m, east_m, up_m, _, _ = _summed(over, back_over)
    offs = (*over, *back_over)
    level_sigma_m = math.hypot(*(off.level_sigma_m for off in offs))
    return Off(north_m, east_m, up_m, level_sigma_m, math.hypot(*(off.up_sigma_m for off in offs)))


def _summed(over: Iterable[Sequence[float]], back_over: Iterable[Sequence[float]]) -> list[float]:
    """What sonars tell on the way up, less what they tell on the way down, value by value."""
    told = [*over, *([-value for value in one] for one in back_over)]
    return [math.fsum(one) for one in zip(*told, strict=True)]


def _towards(slot: GlobalPosition, there: GlobalPosition | None) -> GlobalPosition:
    """A slot moved most of the way to who flies in it: not all, or the last of a line swings."""
    if there is None:
        return slot
    north_m, east_m, _ = ned_between(slot, there)
    return displace(slot, (FLOWN_SHARE * north_m, FLOWN_SHARE * east_m, 0.0))


def _slot_then(
    follower: FollowerState, at_s: float
) -> tuple[GlobalPosition | None, Horizontal, float]:
    """Where a follower's slot is at a moment, its velocity, and the bearing of its bar."""
    if follower.hold is not None:
        return follower.hold.place, (0.0, 0.0), follower.heading_rad
    guided = follower.guided
    if guided is None:
        return None, (0.0, 0.0), 0.0
    since_s = at_s - guided.at_s
    north, east = guided.slot_mps
    place = displace(guided.slot, (north * since_s, east * since_s, 0.0))
    return place, guided.slot_mps, guided.course_rad
