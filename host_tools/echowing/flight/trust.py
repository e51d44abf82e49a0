"""Which positions are believed: receivers that jump, and two vehicles with one id. Pure.

A jump that the sonar denies is the receiver's and goes into the estimate. After a jump that it
cannot deny the follower holds until its pilot has left Guided and come back.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from echowing.flight.alignment import Report
from echowing.flight.drift import Drift
from echowing.flight.follower import FollowerState
from echowing.flight.jumps import SAME_RANGE_M, UNCONFIRMED_S
from echowing.flight.known import Known
from echowing.flight.said import Say
from echowing.flight.streams import Streams
from echowing.geo import displace

# Reports that agree on a leader's new place before the sonar is checked (0.5 s at 4 Hz).
CONFIRMING_REPORTS = 2


class Trust:
    """Accepts the positions that can be believed.

    doubt(system_id, text, now_s) refuses a vehicle for good; alert(system_id, text) goes to a
    follower's pilot; strict: in the field. A simulated ground station without limits believes a
    leader's new place as soon as its reports agree.
    """

    def __init__(
        self,
        known: Known,
        say: Say,
        alert: Callable[[int, str], None],
        doubt: Callable[[int, str, float], None] | None,
        *,
        strict: bool,
    ) -> None:
        self._known, self._say, self._alert, self._doubt = known, say, alert, doubt
        self._strict = strict
        self._leader_jumps = False
        self._streams = {system_id: Streams() for system_id in (known.leader_id, *known.followers)}
        self._doubled: set[int] = set()
        self._unbelieved: set[int] = set()

    def is_sure(self, system_id: int, message: Any, now_s: float) -> bool:
        """Whether a GLOBAL_POSITION_INT is from the one vehicle with this id that is known.

        The leader's are judged by its track too, which believes a new place only after a while.
        """
        if self._doubt is None or system_id not in self._streams:
            return True
        streams = self._streams[system_id]
        sure = streams.is_sure(message, now_s)
        if streams.two:
            self._refuse_two(system_id, now_s)
        follower = self._known.followers.get(system_id)
        if follower is None:
            return True
        follower.unsure = not sure
        return sure

    def leader_reported(self, message: Any, now_s: float) -> None:
        """Take the leader's GLOBAL_POSITION_INT."""
        leader = self._known.leader
        rejected, jumps, before = leader.rejected, leader.jumps, leader.fix
        leader.receive(message, now_s)
        if leader.jumps > jumps:
            self._believed_elsewhere(now_s)
        if self._strict:
            self._settle_leaders_jump(now_s)
        if leader.fix is not None and leader.fix is not before:
            self._known.note_leader(leader.fix)
        jumped = leader.rejected > rejected
        if self._strict and jumped and not self._leader_jumps:
            self._say(now_s, "leader jumps: not believed until its reports agree again")
        self._leader_jumps = jumped

    def follower_reported(self, follower: FollowerState, report: Report) -> None:
        """Take a follower's own report."""
        moved_m = None if self._doubt is None else follower.own_jump.reported(report)
        if moved_m is not None:
            follower.estimate.history.clear()
            follower.drift.jumped()
            follower.slews = True
            if follower.hold is not None:
                # It stands where it stood; only its coordinates have changed.
                place = displace(follower.hold.place, (*moved_m, 0.0))
                follower.hold = replace(follower.hold, place=place)
        place = self._known.in_height(follower.plan.system_id, report.position)
        follower.estimate.reported(replace(follower.drifted(report), position=place))

    def settle(self, follower: FollowerState, now_s: float) -> None:
        """Decide on a follower's own jump once the sonar has had time to deny it."""
        self._note_sonar(follower, now_s)
        jump = follower.own_jump
        if jump.since_s is None:
            self._prove(follower, now_s)
            return
        moved_m = jump.moved_m
        far_m = math.hypot(*moved_m)
        denied = self._sonar_denies(follower, jump.since_s)
        if not denied and now_s - jump.since_s < UNCONFIRMED_S:
            return
        jump.settled()
        if not follower.in_guided or far_m < SAME_RANGE_M:
            return
        if denied:
            follower.estimate.jumped((-moved_m[0], -moved_m[1]))
            for one in self._known.behind(follower):
                one.estimate.jumped(moved_m)
            text = "the sonar's range did not change, allowed for"
        else:
            follower.turn.latched = f"its position jumped by {far_m:.1f} m, until it leaves Guided"
            text = "held until its pilot has left Guided and come back"
        self._say(
            now_s,
            f"follower {follower.plan.system_id}: its receiver jumped by {far_m:.1f} m: {text}",
        )

    def _prove(self, follower: FollowerState, now_s: float) -> None:
        """Whom its sonar has heard since the last jump is where he is seen."""
        ahead = self._known.ahead_of(follower)
        last_s = follower.own_jump.last_s
        if ahead is None:
            # A leader that is believed elsewhere has not been heard since (`_believed_elsewhere`).
            jumps = self._known.leader.jump_since_s is not None
        else:
            jumps, last_s = ahead.own_jump.since_s is not None, max(last_s, ahead.own_jump.last_s)
        if jumps or follower.estimate.offset.unheard_s(now_s) >= now_s - last_s:
            return
        north_m, east_m = self._known.unsettled_m(follower)
        follower.proven_m = follower.proven_m[0] + north_m, follower.proven_m[1] + east_m

    def _note_sonar(self, follower: FollowerState, now_s: float) -> None:
        """Say it once when a sonar is believed no more, and once when it is believed again."""
        system_id, believed = follower.plan.system_id, follower.estimate.is_believed
        if not self._strict or believed is (system_id not in self._unbelieved):
            return
        self._unbelieved ^= {system_id}
        fault = "is stuck" if follower.estimate.is_stuck else "hears anything"
        text = "sonar is believed again" if believed else f"sonar {fault}, not believed"
        self._say(now_s, f"follower {system_id}: {text}")
        if not believed:
            self._alert(system_id, text)

    def _sonar_denies(self, follower: FollowerState, since_s: float) -> bool:
        """Whether its sonar had detected the leader, and its range is as before that moment."""
        learns = self._known.settings.learn_offset
        if not learns or not follower.estimate.hears(since_s):
            return False
        return follower.readings.ranges.unchanged(since_s)

    def _settle_leaders_jump(self, now_s: float) -> None:
        """A jump that the sonar denies is the receiver's: it goes into everybody's estimate."""
        leader, followers = self._known.leader, self._known.behind(None)
        since_s = leader.jump_since_s
        if since_s is None or leader.agreeing < CONFIRMING_REPORTS:
            return
        if not any(self._sonar_denies(one, since_s) for one in followers):
            return
        moved_m = leader.believe_jump()
        self._known.leader_history.clear()
        for follower in followers:
            follower.estimate.jumped(moved_m)
        self._say(
            now_s,
            f"leader's receiver jumped by {math.hypot(*moved_m):.1f} m: the sonar's range did not "
            "change, allowed for",
        )

    def _believed_elsewhere(self, now_s: float) -> None:
        """The leader is believed in a new place that no sonar has confirmed: nobody flies there."""
        self._known.leader_history.clear()
        self._known.leader.drift = Drift()
        for follower in self._known.behind(None):
            follower.estimate.forget()
        if not self._strict:
            return
        if self._known.leader_id in self._doubled:
            return
        jump_m = math.hypot(*self._known.leader.jump_m)
        self._latch_all(f"leader jumped by {jump_m:.1f} m")
        self._say(
            now_s,
            f"leader's reports agree {jump_m:.1f} m away from where it was: nobody is flown there "
            "until its pilot has left Guided and come back",
        )

    def _latch_all(self, reason: str) -> None:
        for system_id, follower in self._known.followers.items():
            follower.turn.latched = f"{reason}, until it leaves Guided"
            if follower.turn.flown:
                self._alert(system_id, f"holding, {reason}")

    def _refuse_two(self, system_id: int, now_s: float) -> None:
        """Two streams of reports in turn: two vehicles with one id."""
        if system_id in self._doubled:
            return
        self._doubled.add(system_id)
        self._say(
            now_s,
            f"two vehicles with id {system_id}, or an old recording on the link: reports come in "
            "turn from two clocks or two places; give each vehicle a MAV_SYSID (SYSID_THISMAV) of "
            "its own",
        )
        followers = self._known.followers
        is_leader = system_id == self._known.leader_id
        if is_leader:
            self._latch_all("two vehicles with the leader's id")
        elif followers[system_id].turn.flown:
            self._alert(system_id, f"no points, two vehicles with id {system_id}")
        whose = "the leader's id" if is_leader else f"id {system_id}"
        if self._doubt is not None:
            self._doubt(system_id, f"two vehicles with {whose}", now_s)
