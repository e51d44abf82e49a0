"""What the applet hears: whole messages, plausible numbers, one sender; and what it lets out."""

from __future__ import annotations

import math
import struct
from typing import TYPE_CHECKING, Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from tests.lua.conftest import CO_PROCESSOR, GROUND_TOOL, HERE, mavlink_frame

from echowing.mavlink.messages import POINT_FORMAT, Manner
from echowing.sim.vehicle.desk import GOOD
from echowing.sim.vehicle.luahost import LuaHost

if TYPE_CHECKING:
    from tests.lua.conftest import MakeRig, Rig

POINT, READING = 86, 251
LEADER_MPS = 2.0
HOLDING = 7
OTHER_TOOL = 99
NEAR_M = 50.0  # a target that leaves the applet is no further off
DAMAGED, IMPLAUSIBLE = "damaged message, not used", "implausible point, not used"
OTHER_FORMAT = "points of another format, not used"
SECOND_SENDER = "points of a second sender, not used"
NO_PLACE = "other scripts leave no place to receive"
# The fields of a point, in the order of the wire, as `follow` fills them for a vehicle that is led.
FIELDS = {
    "time_boot_ms": 0,
    "lat": round(HERE[0] * 1e7),
    "lon": round(HERE[1] * 1e7),
    "up_m": 10.0,
    "north_mps": LEADER_MPS,
    "east_mps": 0.0,
    "down_mps": 0.0,
    "opens_m": 0.0,
    "manner": 0.0,
    "format": POINT_FORMAT,
    "yaw_rad": 0.0,
    "quickens_mps2": 0.0,
    "mask": 0x09C0,
    "system": 1,
    "component": 1,
    "frame": 6,
}


def point(**changed: float) -> bytes:
    return struct.pack("<Iii9fHBBB", *{**FIELDS, **changed}.values())


def reading(range_m: float, board_ms: int = 1000) -> bytes:
    return struct.pack("<If10s", board_ms, range_m, b"SNR_RAW")


def hear(r: Rig, *frames: bytes) -> None:
    r.vehicle.inbox.extend((frame, 0) for frame in frames)
    r.run(0.06)


def led(r: Rig, seconds: float = 1.0, **changed: float) -> Rig:
    """Behind a leader of the same speed, 3 m away, a point each 0.12 s."""
    r.vehicle.velocity = (LEADER_MPS, 0.0, 0.0)
    r.range(3.0)
    r.raw_every_ms = 100
    for _ in range(round(seconds / 0.12)):
        r.vehicle.inbox.append((mavlink_frame(POINT, point(**changed), GROUND_TOOL), 0))
        r.run(0.12)
    return r


def heard(r: Rig) -> tuple[Any, Any]:
    """When the applet took its newest point and its newest single reading."""
    return r.host.local_value("stream")["at_ms"], r.host.local_value("track")["raw_ms"]


def count(r: Rig) -> int:
    return int(r.host.local_value("refused")["count"])


def numbers_out(r: Rig) -> list[float]:
    """Every number that has left the applet."""
    targets = [n for _, target in r.vehicle.targets for n in target if isinstance(n, float)]
    named = [value for values in r.vehicle.named.values() for value in values]
    return targets + named + r.vehicle.desired_speeds


# ---- whole messages -----


def test_the_checksums_seeds_are_the_dialects(rig: MakeRig) -> None:
    seeds = dict(rig().run(0.1).host.local_value("CRC_EXTRA"))
    assert set(seeds) == {POINT, READING}
    assert seeds == {number: mavlink.mavlink_map[number].crc_extra for number in seeds}


@pytest.mark.parametrize("old", [False, True], ids=["MAVLink 2", "MAVLink 1"])
def test_whole_messages_are_heard(rig: MakeRig, old: bool) -> None:
    """The generations of `rig` have the narrow and the wide structure."""
    r = rig().run(0.5)
    hear(r, mavlink_frame(POINT, point(), GROUND_TOOL, old=old))
    hear(r, mavlink_frame(READING, reading(2.5), CO_PROCESSOR, old=old))
    assert None not in heard(r)
    assert r.host.local_value("stream")["north_mps"] == LEADER_MPS
    assert r.host.local_value("track")["same_m"] == 2.5
    assert count(r) == 0


@pytest.mark.parametrize("length", [9, 15, 18])
def test_zeros_at_the_end_may_be_sent_or_left_out(rig: MakeRig, length: int) -> None:
    """A name of one letter ends after 9 bytes; SNR_RAW after 15; sent in full they are 18."""
    payload = reading(2.5)[:length]
    frame = mavlink_frame(READING, payload, CO_PROCESSOR)
    if length == 18:  # MAVLink 2 with its zeros, which a sender may leave in
        head = bytes([18, 0, 0, 0, CO_PROCESSOR, 191]) + READING.to_bytes(3, "little")
        extra = bytes([mavlink.mavlink_map[READING].crc_extra])
        checksum = mavlink.x25crc(head + payload + extra).crc
        frame = b"\xfd" + head + payload + checksum.to_bytes(2, "little")
    r = rig().run(0.5)
    hear(r, frame)
    assert (heard(r)[1] is not None) == (length >= 15)
    assert count(r) == 0  # whole, whatever its name


@pytest.mark.parametrize("old", [False, True], ids=["MAVLink 2", "MAVLink 1"])
def test_a_message_with_one_changed_bit_is_not_heard(rig: MakeRig, old: bool) -> None:
    r = rig().run(0.5)
    for number, payload, system in (
        (POINT, point(), GROUND_TOOL),
        (READING, reading(2.5), CO_PROCESSOR),
    ):
        whole = mavlink_frame(number, payload, system, old=old)
        for place in range(1, len(whole)):
            damaged = bytearray(whole)
            damaged[place] ^= 1 << place % 8
            hear(r, bytes(damaged))
            assert heard(r) == (None, None), (number, place)
    assert count(r) > 60  # all but those with another id
    assert r.texts.count(DAMAGED) == 1


def test_flags_that_it_does_not_know_are_not_passed_over(rig: MakeRig) -> None:
    """Flag 1 is a signature, behind the checksum. Others change what stands where."""
    for flags, is_heard in ((1, True), (2, False), (3, False)):
        head = bytes([len(point()), flags, 0, 0, GROUND_TOOL, 191]) + POINT.to_bytes(3, "little")
        extra = bytes([mavlink.mavlink_map[POINT].crc_extra])
        checksum = mavlink.x25crc(head + point() + extra).crc
        r = rig().run(0.5)
        hear(r, b"\xfd" + head + point() + checksum.to_bytes(2, "little") + bytes(13))
        assert (heard(r)[0] is not None) == is_heard


def test_a_flood_of_damaged_frames_changes_nothing_of_a_hold(rig: MakeRig) -> None:
    """100 a second beside the points: each target is the same, to the digit."""
    calm, flooded = (led(rig(), 2.0) for _ in range(2))
    bad = mavlink_frame(POINT, point(lat=FIELDS["lat"] + 900, north_mps=-9.0), GROUND_TOOL)
    bad = bad[:-1] + bytes([bad[-1] ^ 1])
    for number in range(500):
        for r in (calm, flooded):
            if number % 12 == 0:
                r.vehicle.inbox.append((mavlink_frame(POINT, point(), GROUND_TOOL), 0))
            if r is flooded:
                r.vehicle.inbox.append((bad, 0))
            r.step()
    assert flooded.state == HOLDING
    assert flooded.vehicle.targets == calm.vehicle.targets
    assert flooded.vehicle.desired_speeds == calm.vehicle.desired_speeds
    assert count(flooded) >= 490
    assert flooded.texts.count(DAMAGED) == 1


def test_a_queue_full_of_the_longest_frames_does_not_end_the_script(rig: MakeRig) -> None:
    """SCR_VM_I_COUNT is 10000: a full queue of ten takes no more than three quarters of it."""
    r = rig()
    r.host = LuaHost(r.vehicle, r.script, generation=r.names.generation, count_instructions=True)
    led(r)
    worst = 0
    for number in range(300):
        for length in (53, 255):
            head = bytes([length, 0, 0, 0, GROUND_TOOL, 191]) + POINT.to_bytes(3, "little")
            frame = b"\xfd" + head + bytes([number % 251]) * (length + 2)
            r.vehicle.inbox.extend([(frame, 0)] * 5)
        r.step()
        worst = max(worst, r.host.instructions)
    assert 3000 < worst < 7500


# ---- plausible numbers -----


@pytest.mark.parametrize("whole", [True, False], ids=["right checksum", "wrong checksum"])
def test_a_velocity_that_is_no_number_goes_nowhere(rig: MakeRig, whole: bool) -> None:
    """Passed on, such a point ended ArduCopter ("Floating point exception")."""
    r = led(rig())
    frame = mavlink_frame(POINT, point(north_mps=math.nan), GROUND_TOOL)
    if not whole:
        frame = frame[:-2] + bytes(b ^ 0x5A for b in frame[-2:])
    before = len(r.vehicle.targets)
    for _ in range(10):
        hear(r, frame)
    assert len(r.vehicle.targets) > before  # it goes on with the last whole one
    assert all(math.isfinite(number) for number in numbers_out(r))
    assert r.texts.count(IMPLAUSIBLE if whole else DAMAGED) == 1
    assert count(r) == 10
    assert r.state == HOLDING


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("lat", 900000001),
        ("lat", -2147483648),
        ("lon", 1800000001),
        ("up_m", math.nan),
        ("up_m", -math.inf),
        ("up_m", 2e4),
        ("north_mps", math.inf),
        ("north_mps", 31.0),
        ("east_mps", math.nan),
        ("east_mps", -1e30),
        ("yaw_rad", math.nan),
        ("yaw_rad", 7.0),
        ("opens_m", math.nan),
        ("opens_m", math.inf),
        ("manner", math.nan),
        ("manner", max(Manner) + 1.0),
        ("quickens_mps2", math.nan),
        ("quickens_mps2", -11.0),
    ],
)
def test_a_point_with_one_impossible_number_is_not_used(
    rig: MakeRig, field: str, value: float
) -> None:
    r = led(rig())
    before_ms = heard(r)[0]
    hear(r, mavlink_frame(POINT, point(**{field: value}), GROUND_TOOL))
    assert heard(r)[0] == before_ms
    assert IMPLAUSIBLE in r.texts


@pytest.mark.parametrize("range_m", [math.nan, math.inf, -1.0, 0.0, 21.0])
def test_an_impossible_reading_is_not_used(rig: MakeRig, range_m: float) -> None:
    r = led(rig())
    r.raw_every_ms = None
    before_ms = heard(r)[1]
    hear(r, mavlink_frame(READING, reading(range_m, r.vehicle.t_ms), CO_PROCESSOR))
    assert heard(r)[1] == before_ms
    assert "implausible reading, not used" in r.texts


@pytest.mark.parametrize("board_ms", [0, 2**31 - 1, 2**31, 2**31 + 2000, 2**32 - 1])
def test_any_clock_of_the_board_is_borne(rig: MakeRig, board_ms: int) -> None:
    """A clock that leaps, even by half of its span, leaves dates within the last second."""
    r = led(rig())
    hear(r, mavlink_frame(READING, reading(3.0, board_ms), CO_PROCESSOR))
    assert r.vehicle.t_ms - 1000 <= heard(r)[1] <= r.vehicle.t_ms
    led(r, 3.0)
    assert r.state == HOLDING
    assert all(math.isfinite(number) for number in numbers_out(r))


def test_a_range_beyond_any_sonar_is_no_measurement(rig: MakeRig) -> None:
    r = rig(DETECT=4.5).range(1e9, GOOD).run(2.0)
    assert set(r.vehicle.named["ECHO_RNG"]) == {0.0}


@pytest.mark.parametrize("pilots_mps", [math.nan, math.inf, -1.0, 0.0, 31.0])
def test_does_not_act_with_a_speed_parameter_that_is_no_speed(
    rig: MakeRig, pilots_mps: float
) -> None:
    """It could not give it back."""
    r = rig()
    r.vehicle.parameters[r.names.speed] = pilots_mps * r.names.units_per_mps
    led(r)
    assert r.vehicle.desired_speeds == []
    assert r.vehicle.targets == []
    assert r.mirror_mps == 0.0
    r.vehicle.parameters[r.names.speed] = 5.0 * r.names.units_per_mps
    assert led(r).state == HOLDING


def test_a_speed_that_is_none_is_not_the_pilots(rig: MakeRig) -> None:
    r = led(rig())
    r.vehicle.parameters[r.names.speed] = math.nan
    led(r)
    r.vehicle.mode = 5
    r.run(0.5)
    assert r.parameter_mps == 10.0


# ---- what leaves -----


@pytest.mark.parametrize(
    ("field", "value"),
    [("north_mps", math.nan), ("east_mps", math.inf), ("yaw_rad", 9.0), ("up_m", -200.0)],
)
def test_no_impossible_target_leaves_whatever_went_wrong_inside(
    rig: MakeRig, field: str, value: float
) -> None:
    r = led(rig())
    before = list(r.vehicle.targets)
    r.host.local_value("stream")[field] = value
    r.run(0.1)
    assert [t for t in r.vehicle.targets[len(before) :] if t[0] == "posvel"] == []
    assert all(math.isfinite(number) for number in numbers_out(r))
    assert r.texts.count("implausible target, not used") == 1
    assert led(r).state == HOLDING


def test_no_far_target_leaves(rig: MakeRig) -> None:
    """80 m back from a leader that the sonar sees: the applet moves points by 5 m at the most."""
    r = led(rig())
    before = len(r.vehicle.targets)
    led(r, lat=FIELDS["lat"] - 7187)  # 80 m
    away_m = [abs(t[0]) for _, t in r.vehicle.targets[before:] if isinstance(t[0], float)]
    assert max(away_m, default=0.0) <= NEAR_M
    assert "implausible target, not used" in r.texts


def test_no_target_leaves_where_the_vehicle_does_not_know_its_place(rig: MakeRig) -> None:
    r = led(rig())
    before = len(r.vehicle.targets)
    for nowhere in (math.nan, math.inf, -3.4e38, 2e5):
        r.vehicle.position = (nowhere, 0.0, -10.0)
        led(r)
        assert len(r.vehicle.targets) == before
    r.vehicle.position = (0.0, 0.0, -10.0)
    r.vehicle.yaw = math.nan
    led(r, mask=0x0DC0)  # a point that tells no yaw: the vehicle's own counts
    assert len(r.vehicle.targets) == before


@pytest.mark.parametrize("mps", [math.nan, math.inf, 31.0, 0.0, -1.0])
def test_no_impossible_speed_leaves(rig: MakeRig, mps: float) -> None:
    r = led(rig())
    before = (len(r.vehicle.desired_speeds), r.parameter_mps)
    for name in ("SPD_MIN", "SPD_MAX"):
        r.host.local_value("C")[name] = mps
        r.vehicle.parameters[f"ECHO_{name}"] = math.nan  # nothing puts it right
    r.run(0.1)
    assert (len(r.vehicle.desired_speeds), r.parameter_mps) == before
    assert r.texts.count("implausible speed, not used") == 1


def test_what_goes_on_is_told_once_and_again_after_it_was_fine(rig: MakeRig) -> None:
    r = led(rig())
    bad = mavlink_frame(POINT, point(north_mps=math.nan), GROUND_TOOL)
    for _ in range(600):
        hear(r, bad)  # 36 s
    assert r.texts.count(IMPLAUSIBLE) == 1
    r.run(29.0)
    hear(r, bad)
    assert r.texts.count(IMPLAUSIBLE) == 1
    r.run(31.0)
    hear(r, bad)
    assert r.texts.count(IMPLAUSIBLE) == 2


def test_the_log_counts_what_was_refused(rig: MakeRig) -> None:
    r = led(rig(LOG_HZ=10))
    for _ in range(4):
        hear(r, mavlink_frame(POINT, point(north_mps=math.nan), GROUND_TOOL))
    r.run(0.2)
    assert r.vehicle.log[-1][1][-1] == 4


# ---- one sender -----


def test_points_count_from_one_sender(rig: MakeRig) -> None:
    r = led(rig())
    for _ in range(30):
        led(r, 0.12)
        hear(r, mavlink_frame(POINT, point(north_mps=9.0), OTHER_TOOL))
        assert r.host.local_value("stream")["north_mps"] == LEADER_MPS
    assert r.texts.count(SECOND_SENDER) == 1


@pytest.mark.parametrize("component", [1, 190])
def test_a_sender_is_a_system_and_its_component(rig: MakeRig, component: int) -> None:
    r = led(rig())
    hear(r, mavlink_frame(POINT, point(north_mps=9.0), GROUND_TOOL, component=component))
    assert r.host.local_value("stream")["north_mps"] == LEADER_MPS


def test_another_sender_counts_once_the_first_is_silent_for_a_second(rig: MakeRig) -> None:
    r = led(rig())
    other = mavlink_frame(POINT, point(north_mps=1.0), OTHER_TOOL)
    for _ in range(15):  # 0.9 s, and it does not keep its own place free by asking
        hear(r, other)
        assert r.host.local_value("stream")["north_mps"] == LEADER_MPS
    r.run(0.2)
    hear(r, other)
    assert r.host.local_value("stream")["north_mps"] == 1.0


def test_a_sender_of_nonsense_keeps_nobody_out(rig: MakeRig) -> None:
    r = rig().run(0.5)
    for nonsense in (point(north_mps=math.nan), point(format=0.0), point(system=9)):
        hear(r, mavlink_frame(POINT, nonsense, OTHER_TOOL))
        hear(r, mavlink_frame(POINT, point(), GROUND_TOOL))
        assert heard(r)[0] is not None
    assert SECOND_SENDER not in r.texts


# ---- the format of points -----


@pytest.mark.parametrize("form", [0.0, 1.0, 2.0, math.nan])
def test_points_of_another_format_are_refused_and_told_once(rig: MakeRig, form: float) -> None:
    r = led(rig(), 2.0, format=form)
    assert heard(r)[0] is None
    assert r.texts.count(OTHER_FORMAT) == 1
    assert r.vehicle.targets == []


@pytest.mark.parametrize(
    "changed",
    [{"mask": 0x0800}, {"mask": 0x0DF8}, {"mask": 0x09C4}, {"mask": 0x09C3}, {"frame": 0}],
    ids=["an acceleration", "position only", "no height", "no place", "another frame"],
)
def test_what_is_no_point_of_the_tool_is_refused(rig: MakeRig, changed: dict[str, int]) -> None:
    """So are a click on the map and `follow --position-only`, which flies with the other applet."""
    r = led(rig(), **changed)
    assert heard(r)[0] is None
    assert OTHER_FORMAT in r.texts


def test_the_parameter_shows_the_format(rig: MakeRig) -> None:
    """Also where somebody has saved another value."""
    r = rig(FORMAT=7.0).run(0.5)
    assert r.vehicle.parameters["ECHO_FORMAT"] == POINT_FORMAT
    assert not any("FORMAT" in text for text in r.texts)


# ---- no place left -----


def crowded(r: Rig) -> Rig:
    """Another script was there first, with one place, and has taken it."""
    r.host._inbox.init(5, 1)
    r.host._inbox.register(33)
    return r


def test_without_a_place_it_says_so_again_and_again_and_lives(rig: MakeRig) -> None:
    r = crowded(rig()).run(25.0)
    assert r.host.running
    assert r.texts.count(NO_PLACE) == 3
    assert r.vehicle.desired_speeds == []
    assert r.mirror_mps == 0.0


def test_without_a_place_arming_is_refused(rig: MakeRig) -> None:
    r = rig()
    r.vehicle.is_armed = False
    crowded(r).run(2.5)
    assert list(r.vehicle.auth.values()) == [f"ECHO: {NO_PLACE}"]


def test_one_place_is_not_enough(rig: MakeRig) -> None:
    r = rig()
    r.host._inbox.init(5, 1)
    r.run(1.0)
    assert NO_PLACE in r.texts


def test_places_that_are_its_own_already_are_fine(rig: MakeRig) -> None:
    """A restart of scripting leaves them registered."""
    r = rig()
    r.host._inbox.init(10, 2)
    for number in (POINT, READING):
        r.host._inbox.register(number)
    assert led(r).state == HOLDING
