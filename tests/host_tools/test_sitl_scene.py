"""Where the emulated sonar has the leader, from what two vehicles in SITL say of themselves."""

import math
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.errors import EchowingError
from echowing.geo import GlobalPosition, Ned, displace
from echowing.sim.boards.sitl_scene import STALE_S, SitlScene, TrueState, in_body_frame

HERE = GlobalPosition(47.0, 8.0, 460.0)
STILL = (0.0, 0.0, 0.0)


def state(
    ned_m: Ned, *, velocity: Ned = STILL, attitude: Ned = STILL, at_s: float = 0.0
) -> TrueState:
    return TrueState(at_s, displace(HERE, ned_m), velocity, attitude)


@pytest.mark.parametrize(
    ("attitude_deg", "seen"),
    [
        ((0.0, 0.0, 0.0), (3.0, 1.0, 0.5)),
        ((0.0, 0.0, 90.0), (1.0, -3.0, 0.5)),  # nose east: north is at its left
        # Nose down by 10 degrees: what is level ahead is above the nose.
        ((0.0, -10.0, 0.0), (3.041, 1.0, -0.029)),
        # Right side down by 10 degrees.
        ((10.0, 0.0, 0.0), (3.0, 1.072, 0.319)),
    ],
)
def test_roll_pitch_and_yaw_turn_what_is_seen(attitude_deg: Ned, seen: Ned) -> None:
    roll, pitch, yaw = map(math.radians, attitude_deg)
    follower = state(STILL, attitude=(roll, pitch, yaw))
    found = in_body_frame(state((3.0, 1.0, 0.5)), follower, 0.0)
    assert found == pytest.approx(seen, abs=2e-3)
    assert math.dist(found, STILL) == pytest.approx(math.dist((3.0, 1.0, 0.5), STILL), abs=1e-3)


def test_both_are_carried_on_to_now() -> None:
    leader = state((3.0, 0.0, 0.0), velocity=(2.0, 0.0, 0.0), at_s=0.96)
    follower = state(STILL, velocity=(1.0, 0.0, 0.0), at_s=0.98)
    assert in_body_frame(leader, follower, 1.0)[0] == pytest.approx(3.0 + 0.08 - 0.02, abs=1e-3)


class Wire:
    """A link with one vehicle on it."""

    def __init__(self, address: Any) -> None:
        self.address, self.signing, self.news = address, None, list[str]()
        self.coming: list[Any] = []
        self.asked: list[Any] = []
        self._mav = mavlink.MAVLink(None)
        WIRES[address.text] = self

    def open(self) -> None: ...

    def close(self) -> None: ...

    def receive(self, now_s: float) -> list[Any]:
        coming, self.coming = self.coming, []
        return coming

    def send(self, frame: bytes, now_s: float) -> None:
        self.asked += self._mav.parse_buffer(frame) or []

    def say(self, system_id: int, message: Any) -> None:
        sender = mavlink.MAVLink(None, system_id, 1)
        self.coming += mavlink.MAVLink(None).parse_buffer(message.pack(sender)) or []


WIRES: dict[str, Wire] = {}


def sim_state(place: GlobalPosition) -> Any:
    numbers = (0.0,) * 13
    return mavlink.MAVLink_sim_state_message(
        0, 0, 0, 0, *numbers[:9], place.lat_deg, place.lon_deg, place.alt_m, 0, 0, 0, 0, 0,
        round(place.lat_deg * 1e7), round(place.lon_deg * 1e7),
    )  # fmt: skip


def beat() -> Any:
    return mavlink.MAVLink_heartbeat_message(2, 3, 0x81, 4, 4, 3)


def test_it_asks_both_and_hears_only_what_is_fresh() -> None:
    now = [0.0]
    told: list[str] = []
    scene = SitlScene(
        "udpin:1",
        "udpin:2",
        clock=lambda: now[0],
        say=told.append,
        make_link=Wire,  # type: ignore[arg-type]
    )

    def step(by_s: float = 0.02) -> Ned | None:
        now[0] += by_s
        for number, text in ((1, "udpin:1"), (2, "udpin:2")):
            WIRES[text].say(number, beat())
        return scene.leader_body_m()

    for _ in range(250):  # five seconds: who is who is watched for four
        assert step() is None
    rates = [m for m in WIRES["udpin:1"].asked if m.get_type() == "COMMAND_LONG"]
    assert (rates[-1].param1, rates[-1].param2) == (mavlink.MAVLINK_MSG_ID_SIM_STATE, 20_000)
    assert rates[-1].target_system == 1
    WIRES["udpin:1"].say(1, sim_state(displace(HERE, (3.5, 0.0, 0.0))))
    assert step() is None  # nothing of the follower yet
    WIRES["udpin:2"].say(2, sim_state(HERE))
    seen = step()
    assert seen is not None
    assert seen == pytest.approx((3.5, 0.0, 0.0), abs=0.02)  # a ten millionth of a degree is 1 cm
    assert told[-1] == "the sonar detects system 1 from system 2"
    assert step(STALE_S + 0.1) is None
    scene.close()


def test_a_truth_too_coarse_is_refused() -> None:
    scene = SitlScene("udpin:1", "udpin:2", clock=lambda: 1.0, make_link=Wire)  # type: ignore[arg-type]
    coarse = mavlink.MAVLink_sim_state_message(*(0.0,) * 13, 47.0, 8.0, 460.0, *(0.0,) * 5)
    WIRES["udpin:1"].say(1, coarse)
    with pytest.raises(EchowingError, match="half a metre"):
        scene.leader_body_m()
