import itertools
import math
from pathlib import Path

import pytest

from echowing.errors import EchowingError
from echowing.sim.scenario import LeaderSection
from echowing.sim.world.leader import TrackedBody, load_track, mission, walk


def length_m(points: list[tuple[float, float, float]]) -> float:
    whole = [(0.0, 0.0, points[0][2]), *points]
    return sum(math.dist(a, b) for a, b in itertools.pairwise(whole))


def test_the_rectangle_is_the_theses_and_closed() -> None:
    points = mission(LeaderSection(laps=1))

    assert points == [
        (60.0, 0.0, -10.0),
        (60.0, 40.0, -10.0),
        (0.0, 40.0, -10.0),
        (0.0, 0.0, -10.0),
    ]


def test_laps_repeat() -> None:
    assert len(mission(LeaderSection(laps=3))) == 12


def test_the_circle_has_its_radius_and_comes_back() -> None:
    points = mission(LeaderSection(path="circle", radius_m=20.0, laps=1))

    assert all(math.hypot(n, e - 20.0) == pytest.approx(20.0) for n, e, _ in points)
    assert points[-1][:2] == pytest.approx((0.0, 0.0), abs=1e-9)
    # 36 chords are a little shorter than the circle.
    assert length_m(points) == pytest.approx(2 * math.pi * 20.0, rel=0.002)
    # It sets off to the north.
    assert points[0][0] > abs(points[0][1])


def test_the_figure_eight_goes_round_both_sides() -> None:
    points = mission(LeaderSection(path="figure-eight", radius_m=15.0, laps=1))

    assert max(e for _, e, _ in points) == pytest.approx(30.0, abs=0.2)
    assert min(e for _, e, _ in points) == pytest.approx(-30.0, abs=0.2)


def test_a_walker_keeps_his_pace_and_faces_where_he_goes() -> None:
    leader = LeaderSection(path="walk", north_m=30.0, east_m=20.0, speed_mps=1.3, altitude_m=1.0)

    rows = walk(leader, 60.0)

    steps = [math.dist(a[1:3], b[1:3]) for a, b in itertools.pairwise(rows)]
    assert max(steps) <= 1.3 * 0.2 + 1e-9
    assert rows[10][4] == pytest.approx(0.0)  # north first
    assert rows[150][4] == pytest.approx(math.pi / 2)  # after 30 m, 23 s: east
    assert all(row[3] == -1.0 for row in rows)


def test_a_runner_walks_round_the_corners() -> None:
    """At full speed he would change his velocity by 5.5 m/s at once: no follower survives that."""
    leader = LeaderSection(path="walk", north_m=30.0, east_m=20.0, speed_mps=3.9, altitude_m=1.0)

    rows = walk(leader, 60.0)

    velocities = [((b[1] - a[1]) / 0.2, (b[2] - a[2]) / 0.2) for a, b in itertools.pairwise(rows)]
    assert max(math.hypot(*each) for each in velocities) == pytest.approx(3.9)
    changes = [math.dist(a, b) for a, b in itertools.pairwise(velocities)]
    assert max(changes) < 2.2  # from a brisk walk to a brisk walk round the corner is 2.1


def test_a_tracked_body_is_where_its_track_says_with_its_velocity() -> None:
    body = TrackedBody([(0.0, 0.0, 0.0, -10.0, 0.0), (2.0, 4.0, 2.0, -10.0, 0.5)])

    body.step(1.0)

    assert (body.north_m, body.east_m, body.down_m) == pytest.approx((2.0, 1.0, -10.0))
    assert (body.vn_mps, body.ve_mps) == pytest.approx((2.0, 1.0))


def test_after_its_track_a_body_stays() -> None:
    body = TrackedBody([(0.0, 0.0, 0.0, -10.0, 0.0), (1.0, 4.0, 0.0, -10.0, 0.0)])

    for _ in range(30):
        body.step(0.1)

    assert body.north_m == pytest.approx(4.0)
    assert body.vn_mps == 0.0


def test_gps_drift_shows_in_the_estimate_only() -> None:
    body = TrackedBody([(0.0, 0.0, 0.0, -10.0, 0.0), (1.0, 1.0, 0.0, -10.0, 0.0)])

    body.set_estimate_offset((1.5, -0.5, 0.0))

    assert body.north_m == 0.0
    assert (body.est_north_m, body.est_east_m) == pytest.approx((1.5, -0.5))


def written(folder: Path, text: str) -> Path:
    path = folder / "track.csv"
    path.write_text(text, encoding="utf-8")
    return path


HEAD = "time_s,north_m,east_m,down_m\n"


def test_a_csv_track_is_read(tmp_path: Path) -> None:
    assert load_track(written(tmp_path, HEAD + "0,0,0,-5\n1,2,0,-5\n")) == [
        (0.0, 0.0, 0.0, -5.0, 0.0),
        (1.0, 2.0, 0.0, -5.0, 0.0),
    ]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (HEAD + "0,0,0,-5\n", "at least two points, this has 1"),
        (HEAD + "0,0,0,-5\n1,x,0,-5\n", "line 3: needs numbers"),
        (HEAD + "0,0,0,-5\n0,1,0,-5\n", "line 3: time_s does not rise"),
        ("a,b\n1,2\n", "line 2: needs numbers in time_s"),
        ("", "at least two points, this has 0"),
    ],
)
def test_a_broken_track_is_named_with_its_line(tmp_path: Path, text: str, says: str) -> None:
    with pytest.raises(EchowingError, match=says):
        load_track(written(tmp_path, text))


@pytest.mark.parametrize("name", ["absent.csv", "absent.tlog"])
def test_an_absent_track_is_named(tmp_path: Path, name: str) -> None:
    with pytest.raises(EchowingError, match=name):
        load_track(tmp_path / name)
