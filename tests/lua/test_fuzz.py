"""The fuzz of the applets: a part of it flown here, and that it finds what it is there to find."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from random import Random

import pytest
from tests.lua import fuzz
from tests.lua.hostile_frames import (
    is_whole,
    mutated,
    spliced,
    spoiled,
    through_radio,
    whole,
)

pytestmark = pytest.mark.seconds(8)

FLIGHTS = 25, pytest.param(80, marks=pytest.mark.long)
# An applet of a few lines that is wrong in one way.
WRONG = """
-- // @Param: ECHO_ENABLE
param:add_table(95, 'ECHO_', 2)
param:add_param(95, 1, 'ENABLE', 0)
param:add_param(95, 2, 'MIRROR', 0)
local speed = param:get('WP_SPD') and 'WP_SPD' or 'WPNAV_SPEED'
local at = Vector3f()
mavlink:init(10, 2)
mavlink:register_rx_msgid(86)
local function update()
    %s
    return update, 50
end
return update, 50
"""
FLY = "vehicle:set_target_posvelaccel_NED(at, {}, Vector3f(), true, 0, false, 0, false)"
LOOK = "mavlink:send_chan(0, 284, ('<fffffffI2BB'):pack({}, 0, 0, 0, 0, 0, {}, {}, 1, 191))"
FAULTS = {
    "script error": "error('x')",
    "target not finite": "at:x(0/0) " + FLY.format("Vector3f()"),
    "far target": "at:x(1000) " + FLY.format("Vector3f()"),
    "fast target": "local v = Vector3f() v:y(100) " + FLY.format("v"),
    "look not finite": LOOK.format("0/0", 0, 92),
    "a look that is no direction": LOOK.format(2, 0, 92),
    "a look beyond what a gimbal can": LOOK.format(1, 9, 92),
    "an order that is not the gimbal's": LOOK.format(1, 0, 0),
    "sends message": "mavlink:send_chan(0, 0, ('x'):rep(9))",
    "not finite in a text": "gcs:send_text(6, string.format('%.1f m', 0/0))",
    "not finite told": "gcs:send_named_float('ECHO_RNG', 1/0)",
    "speed limit": "vehicle:set_desired_speed(0)",
    "speed parameter": "param:set(speed, -1)",
    "handed back at": "param:set(speed, param:get(speed) * 0.5)",
    "not handed back": "param:set('ECHO_MIRROR', 5)",
    "not in control again": "",
    "wrong checksums changed the flight": "local m = mavlink:receive_chan() if m then"
    " vehicle:set_desired_speed(1 + m:byte(18) / 100) end param:set('ECHO_MIRROR', "
    "vehicle:get_mode() == 4 and 1 or 0)",
}


@pytest.mark.parametrize("flights", FLIGHTS)
@pytest.mark.parametrize("applet", fuzz.applets(), ids=lambda path: path.stem)
def test_some_flights_break_nothing(applet: Path, flights: int) -> None:
    for number in range(flights):
        problem = fuzz.broken(fuzz.draw(applet, number))
        again = f"python -m tests.lua.fuzz --applet {applet.stem} --case {number}"
        assert problem is None, f"{problem}; again: {again}"


@pytest.mark.parametrize("fault", FAULTS)
def test_it_finds(fault: str, tmp_path: Path) -> None:
    applet = tmp_path / "echowing.lua"
    applet.write_text(WRONG % FAULTS[fault])
    found = {fuzz.kind_of(fuzz.broken(fuzz.draw(applet, number))) for number in range(12)}
    assert any(problem.startswith(fault) for problem in found), found


def test_a_find_is_made_small_and_flies_again(tmp_path: Path) -> None:
    applet = tmp_path / "echowing.lua"
    faulty = "local m = mavlink:receive_chan() if m and m:byte(4) > 53 then error('long') end"
    applet.write_text(
        WRONG % (faulty + " param:set('ECHO_MIRROR', vehicle:get_mode() == 4 and 1 or 0)")
    )
    case = next(
        case
        for case in (fuzz.draw(applet, number) for number in range(400))
        if "long" in (fuzz.broken(case) or "")
    )
    problem = fuzz.broken(case)
    places = fuzz.smallest(case, fuzz.kind_of(problem))
    small = fuzz.kept(case, places)
    assert "long" in (fuzz.broken(small) or "")
    assert [action[0] for action in small.actions].count("frame") == 1
    assert fuzz.draw(applet, case.number) == case


def test_frames_are_what_they_are_called() -> None:
    rng = Random(1)
    frames = [whole(rng, 1000) for _ in range(300)]
    assert all(map(is_whole, frames))
    assert {frame[0] for frame in frames} == {0xFE, 0xFD}
    assert not any(is_whole(spoiled(rng, frame)) for frame in frames)
    assert through_radio(rng, b"".join(frames), 0.0) == frames
    joined = through_radio(rng, b"".join(frames), 0.1)
    assert 0 < sum(not is_whole(frame) for frame in joined) < len(joined) / 2
    others = [mutated(rng, frame) for frame in frames]
    assert {is_whole(frame) for frame in others} == {True, False}
    assert all(
        len(spliced(rng, *pair)) == len(pair[0]) for pair in zip(frames, others, strict=True)
    )


def test_an_unknown_applet_is_refused() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "tests.lua.fuzz", "--applet", "none"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2
    assert "invalid choice: 'none'" in done.stderr
