"""The commands as a user runs them, each a process of its own."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

pytestmark = pytest.mark.seconds(30)
RECORDINGS = Path(__file__).parents[1] / "host_tools" / "data" / "sitl"


def echowing(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "echowing", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)


def succeeded(*arguments: str | Path) -> str:
    done = echowing(*arguments)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """The folder of a flight of 90 s, flown by the command, and what it printed."""
    folder = tmp_path_factory.mktemp("flight")
    return folder, succeeded("sim", "echowing", "--seed", "3", "--duration", "90", "--out", folder)


@pytest.fixture(scope="module")
def flight(flown: tuple[Path, str]) -> Path:
    """The folder of that flight."""
    return flown[0]


def test_sim_prints_one_object_a_flight() -> None:
    lines = succeeded("sim", "gray", "--seed", "4-5", "--duration", "15", "--json").splitlines()

    flights: list[dict[str, Any]] = [json.loads(line) for line in lines]
    assert [one["seed"] for one in flights] == [4, 5]
    for one in flights:
        assert set(one) >= {
            "scenario",
            "seed",
            "law",
            "mean_separation_m",
            "mean_abs_error_m",
            "rmsd_m",
            "std_m",
            "min_separation_m",
            "max_separation_m",
            "slot_error_m",
            "seen_share",
            "simulated_s",
            "wall_s",
        }
        assert one["scenario"] == "gray"
        assert one["law"] == "none"
        assert one["simulated_s"] == pytest.approx(15.0)
        assert one["min_separation_m"] <= one["mean_separation_m"] <= one["max_separation_m"]


def test_the_law_and_the_settings_reach_the_flight() -> None:
    changed = ("--law", "bands", "--set", "gps.sigma_m=0.0", "--duration", "15")

    plain = json.loads(succeeded("sim", "echowing", "--duration", "15", "--json"))
    other = json.loads(succeeded("sim", "echowing", *changed, "--json"))

    assert (plain["law"], other["law"]) == ("hold", "bands")
    assert other["mean_separation_m"] != plain["mean_separation_m"]


def test_sim_leaves_logs_truth_and_a_report(flight: Path) -> None:
    names = {path.name for path in flight.iterdir()}

    assert names == {"leader.tlog", "follower-2.tlog", "truth.csv", "report.html"}
    page = (flight / "report.html").read_text(encoding="utf-8")
    assert "<script" in page
    assert 'src="http' not in page


def test_analyze_finds_in_the_logs_what_was_true(flown: tuple[Path, str]) -> None:
    flight, printed = flown
    output = succeeded(
        "analyze",
        flight / "leader.tlog",
        flight / "follower-2.tlog",
        "--json",
    )

    found = json.loads(output)
    # Two receivers of 0.8 m a piece: the logs may be off by their drift, and by no more.
    assert abs(found["truth"]["bias_m"]) < 2.5
    assert found["truth"]["rms_m"] < 2.5
    # Logged telemetry is 0.46 s late; the vehicles' own time stamps take that out.
    assert abs(found["truth"]["clock_shift_s"]) < 0.2
    # The same rule for the approach: in truth the figures are those that `sim` has printed, but for
    # the truth's clock, which is matched to the logs' to a few hundredths of a second.
    row = next(line.split() for line in printed.splitlines() if line.startswith(" Echowing"))
    figures = ("mean_separation_m", "mean_abs_error_m", "rmsd_m")
    for figure, cell in zip(figures, row[2:], strict=False):
        assert found["in_truth"][figure] == pytest.approx(float(cell), abs=0.03)
    assert found["source"] == "in truth"
    assert found["mean_abs_error_m"] == found["in_truth"]["mean_abs_error_m"]
    # While it detects the leader, and up to 0.1 s old: as long as both fly it is a decimetre off.
    true_m = found["in_truth"]["mean_separation_m"]
    assert found["by_sonar"]["mean_separation_m"] == pytest.approx(true_m, abs=0.3)


def test_analyze_refuses_one_vehicle_alone(flight: Path) -> None:
    done = echowing("analyze", flight / "leader.tlog")

    assert done.returncode == 2
    assert "a flight needs a leader and a follower" in done.stderr
    assert "Traceback" not in done.stderr


def test_calibrate_prints_every_recordings_error() -> None:
    rows = json.loads(succeeded("calibrate", RECORDINGS, "--json"))

    assert len(rows) == len(list(RECORDINGS.rglob("*.csv"))) == 20
    assert all(row["rms_position_error_m"] < 0.10 for row in rows)


def test_calibrate_takes_the_wind_and_refuses_none() -> None:
    still = json.loads(succeeded("calibrate", RECORDINGS / "4.6", "--json"))
    blown = json.loads(succeeded("calibrate", RECORDINGS / "4.6", "--wind", "6", "60", "--json"))
    refused = echowing("calibrate", RECORDINGS, "--wind", "-1", "60")

    assert [row["generation"] for row in still] == ["4.6"] * 6
    assert all(a["max_error_m"] != b["max_error_m"] for a, b in zip(still, blown, strict=True))
    assert refused.returncode == 2
    assert "give a speed of 0 m/s or more" in refused.stderr


def test_a_scenario_of_ones_own_is_flown(tmp_path: Path) -> None:
    mine = tmp_path / "mine.toml"
    mine.write_text(
        'title = "mine"\nduration_s = 15\n[leader]\npath = "circle"\nradius_m = 15\n',
        encoding="utf-8",
    )

    found = json.loads(succeeded("sim", mine, "--json"))

    assert found["scenario"] == "mine"


def test_a_recorded_track_leads(tmp_path: Path) -> None:
    track = tmp_path / "track.csv"
    rows = "\n".join(f"{t},{1.5 * t},0,-10,0" for t in range(60))
    track.write_text(f"time_s,north_m,east_m,down_m,yaw_rad\n{rows}\n", encoding="utf-8")
    set_track = ("--set", 'leader.path="track"', "--set", f'leader.track="{track}"')

    found = json.loads(succeeded("sim", "echowing", *set_track, "--duration", "30", "--json"))

    assert found["mean_abs_error_m"] < 1.5


def test_a_flights_telemetry_can_lead_another(flight: Path) -> None:
    set_track = ("--set", 'leader.path="track"', "--set", f'leader.track="{flight}/leader.tlog"')

    found = json.loads(succeeded("sim", "echowing", *set_track, "--duration", "25", "--json"))

    assert found["min_separation_m"] > 1.0


def test_interrupted_flights_say_so_and_leave_readable_logs(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "echowing", "sim", "--duration", "3000", "--out", tmp_path]
    flying = subprocess.Popen(list(map(str, command)), stderr=subprocess.PIPE, text=True)
    log = tmp_path / "leader.tlog"
    while not (log.exists() and log.stat().st_size > 5000):
        assert flying.poll() is None
    flying.send_signal(2)

    _, said = flying.communicate(timeout=120)

    assert flying.returncode == 130
    assert "interrupted" in said
    assert "Traceback" not in said
    assert log.stat().st_size > 5000
