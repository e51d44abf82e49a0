"""The model against recordings of ArduCopter 4.6, 4.7 and 4.8 in SITL, and bad recordings."""

import csv
import math
from pathlib import Path

import pytest

from echowing.bench.calibrate import (
    STATE_COLUMNS,
    estimate_mission,
    read_recording,
    replay,
    replay_directory,
)
from echowing.errors import EchowingError
from echowing.sim.vehicle.copter import Copter
from echowing.sim.vehicle.parameters import Generation

RECORDINGS = Path(__file__).parent / "data" / "sitl"
# The wish is 0.10 m for each recording without wind; this is what each reaches and about a third
# more, so that a change of the model that makes one worse shows here.
BOUNDS_M = {
    "4.8": {
        "cap_steps": 0.10,
        "leader_auto_rectangle_2mps": 0.06,
        "posvel_cap1": 0.05,
        "step20_cap2": 0.04,
        "step20_cap5": 0.055,
        "step3_cap5": 0.06,
        "stream_pos_2mps": 0.035,
        "stream_posvel_2mps": 0.08,
    },
    "4.6": {
        "cap_steps": 0.10,
        "posvel_cap1": 0.05,
        "step20_cap2": 0.04,
        "step3_cap5": 0.045,
        "stream_pos_2mps": 0.03,
        "stream_posvel_2mps": 0.06,
    },
    "4.7": {
        "cap_steps": 0.07,
        "posvel_cap1": 0.05,
        "step20_cap2": 0.04,
        "step3_cap5": 0.045,
        "stream_pos_2mps": 0.03,
        "stream_posvel_2mps": 0.06,
    },
}


def test_every_recording_is_replayed_within_its_bound() -> None:
    results = replay_directory(RECORDINGS)
    flown = {(result.generation, result.name) for result in results}
    assert flown == {(known, name) for known, bounds in BOUNDS_M.items() for name in bounds}
    for result in results:
        bound_m = BOUNDS_M[result.generation][result.name]
        assert bound_m <= 0.10
        assert result.rms_position_error_m < bound_m, (result.generation, result.name)
        assert result.rms_position_error_m <= result.max_error_m
        assert result.kind == ("auto" if "auto" in result.name else "guided")
    assert results[0].duration_s == pytest.approx(39.96)


def test_another_generation_flies_a_recording_worse() -> None:
    recording = RECORDINGS / "4.6" / "stream_pos_2mps.csv"
    right, wrong = replay(recording), replay(recording, Generation.V4_8)
    assert wrong.rms_position_error_m > right.rms_position_error_m + 0.15


def test_known_waypoints_bring_the_mission_nearer(tmp_path: Path) -> None:
    name = "leader_auto_rectangle_2mps"
    recording = tmp_path / f"{name}.csv"
    recording.write_bytes((RECORDINGS / f"{name}.csv").read_bytes())
    (tmp_path / f"{name}.toml").write_text(
        "speed_mps = 2\nwaypoints_m = [[60, 0], [60, 40], [0, 40], [0, 0]]\n"
    )
    assert replay(recording).rms_position_error_m < 0.1


def test_waypoints_are_seen_in_the_track() -> None:
    path = RECORDINGS / "leader_auto_rectangle_2mps.csv"
    mission = estimate_mission(path, read_recording(path))
    assert mission.speed_mps == pytest.approx(2.0)
    expected = [(60.0, 0.0), (60.0, 40.0), (0.0, 40.0), (0.0, 0.0)]
    assert len(mission.waypoints_m) == 4
    for point, wanted in zip(mission.waypoints_m, expected, strict=True):
        assert math.dist(point[:2], wanted) < 0.05


@pytest.mark.parametrize("angle_rad", [0.6, math.pi / 2, -2.5])
@pytest.mark.parametrize("mirror", [1.0, -1.0])
@pytest.mark.parametrize("name", ["step20_cap5", "stream_posvel_2mps", "cap_steps"])
def test_turned_or_mirrored_recording_gives_the_same_error(
    tmp_path: Path, name: str, mirror: float, angle_rad: float
) -> None:
    turned = tmp_path / f"{name}.csv"
    turn_recording(RECORDINGS / f"{name}.csv", turned, angle_rad, mirror)
    original = replay(RECORDINGS / f"{name}.csv")
    # Each axis of the lean has limits of its own, as in ArduCopter: only a turn by 90 degrees gives
    # the same to the last digit, another the same within 0.03 mm.
    bound_m = 1e-6 if angle_rad == math.pi / 2 else 1e-4
    assert replay(turned).rms_position_error_m == pytest.approx(
        original.rms_position_error_m, abs=bound_m
    )


def turn_recording(source: Path, target: Path, angle_rad: float, mirror: float) -> None:
    """Rotate every north/east pair of a recording, mirrored east for west first if asked."""
    cosine, sine = math.cos(angle_rad), math.sin(angle_rad)
    pairs = [("north_m", "east_m"), ("vn_mps", "ve_mps"), ("cmd_n", "cmd_e"), ("cmd_vn", "cmd_ve")]
    with source.open() as file, target.open("w", newline="") as out:
        reader = csv.DictReader(file)
        writer = csv.DictWriter(out, reader.fieldnames or [])
        writer.writeheader()
        for row in reader:
            for one, two in pairs:
                if row[one]:
                    north, east = float(row[one]), mirror * float(row[two])
                    row[one] = repr(north * cosine - east * sine)
                    row[two] = repr(north * sine + east * cosine)
            writer.writerow(row)


@pytest.mark.parametrize(
    ("waypoints", "speed_mps"),
    [
        ([(40.0, 0.0), (20.0, 35.0), (0.0, 0.0)], 3.0),
        ([(15.0, 0.0), (15.0, 15.0), (0.0, 15.0), (0.0, 0.0)], 8.0),  # never reaches 8 m/s
        ([(30.0, 30.0), (60.0, 25.0), (90.0, 60.0)], 5.0),
        ([(20.0, 0.0), (20.0, -30.0), (-10.0, -30.0)], 1.25),
    ],
)
def test_mission_of_another_shape_is_understood(
    tmp_path: Path, waypoints: list[tuple[float, float]], speed_mps: float
) -> None:
    path = tmp_path / "mission.csv"
    copter = Copter((0.0, 0.0, -10.0), flying=True)
    copter.start_auto([(north, east, -10.0) for north, east in waypoints], speed_mps)
    lines = [HEADER]
    for k in range(2000):
        copter.step(0.04)
        lines.append(
            f"{0.04 * (k + 1)},{copter.north_m},{copter.east_m},{copter.down_m},"
            f"{copter.vn_mps},{copter.ve_mps},{copter.vd_mps},{copter.yaw_rad}"
        )
    path.write_text("\n".join(lines) + "\n")
    assert replay(path).rms_position_error_m < 0.25


HEADER = ",".join(STATE_COLUMNS)
COMMANDS = HEADER + ",cmd_n,cmd_e,cmd_vn,cmd_ve,speed_cap"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "line 1: the file is empty"),
        ("time_s,north_m\n", "line 1: columns missing: east_m"),
        (HEADER + ",cmd_n\n", "columns missing: cmd_e"),
        (HEADER + "\n", "0 rows of data"),
        (HEADER + "\n0,0,0,0,0,0,0\n", "line 2: 7 columns where the header has 8"),
        (HEADER + "\n0,0,x,0,0,0,0,0\n", "line 2: east_m is 'x', not a number"),
        (HEADER + "\n0,0,nan,0,0,0,0,0\n", "line 2: east_m is 'nan', not a number"),
        (HEADER + "\n0,0,0,0,0,0,0,0\n0,0,0,0,0,0,0,0\n", "line 3: time_s does not increase"),
        (COMMANDS + "\n0,0,0,0,0,0,0,0,5,,,,2\n", "cmd_n and cmd_e must be given together"),
        (COMMANDS + "\n0,0,0,0,0,0,0,0,5,0,,,-2\n", "speed_cap is -2"),
        (COMMANDS + "\n0,0,0,0,0,0,0,0,,,1,0,2\n", "without a target"),
    ],
)
def test_malformed_recording_names_file_line_and_fault(
    tmp_path: Path, text: str, message: str
) -> None:
    path = tmp_path / "bad.csv"
    path.write_text(text)
    with pytest.raises(EchowingError, match=message) as caught:
        replay(path)
    assert str(path) in str(caught.value)


def test_folder_without_recordings(tmp_path: Path) -> None:
    with pytest.raises(EchowingError, match="no recordings"):
        replay_directory(tmp_path)
    with pytest.raises(EchowingError, match="not a folder"):
        replay_directory(tmp_path / "nowhere")


def test_binary_file_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "image.csv"
    path.write_bytes(b"\xff\xd8\xff\xe0" * 10)
    with pytest.raises(EchowingError, match="cannot be read as CSV"):
        replay(path)


def test_mission_without_straight_legs_asks_for_waypoints(tmp_path: Path) -> None:
    path = tmp_path / "circle.csv"
    rows = [HEADER]
    for k in range(500):
        time_s = 0.04 * (k + 1)
        angle = 0.5 * time_s
        north, east = 4.0 * math.sin(angle), -4.0 * math.cos(angle)
        vn, ve = 2.0 * math.cos(angle), 2.0 * math.sin(angle)
        rows.append(f"{time_s},{north},{east},-10,{vn},{ve},0,{angle}")
    path.write_text("\n".join(rows) + "\n")
    with pytest.raises(EchowingError, match=r"give waypoints_m and speed_mps in circle\.toml"):
        replay(path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("speed_mps = 0\nwaypoints_m = [[1, 2]]", "speed_mps must be"),
        ("speed_mps = 2\nwaypoints_m = []", "waypoints_m must be a list"),
        ("speed_mps = 2\nwaypoints_m = [[1]]", "is not a waypoint"),
        ("speed_mps = 2\nwaypoints_m = [[1, 'x']]", "is not a waypoint"),
        ("speed = 2", "unknown keys speed"),
        ("speed_mps = ", "mission.toml"),
    ],
)
def test_bad_sidecar_is_named(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "mission.csv"
    path.write_bytes((RECORDINGS / "leader_auto_rectangle_2mps.csv").read_bytes())
    path.with_suffix(".toml").write_text(text)
    with pytest.raises(EchowingError, match=message):
        replay(path)
