import pytest

from echowing.cli import main
from echowing.errors import EchowingError
from echowing.flight.guidance import LeaderFix
from echowing.flight.relay import RelayGuide, parse_ground
from echowing.geo import GlobalPosition, displace, ned_between

GROUND = GlobalPosition(39.34, -86.03, 250.0)


def test_the_point_is_midway_to_where_the_remote_vehicle_is_now() -> None:
    remote = displace(GROUND, (200.0, -100.0, 0.0))
    fix = LeaderFix(10.0, remote, (4.0, 0.0, 0.0), 0.0)

    guided = RelayGuide(GROUND).update(fix, 10.5)

    # Half a second at 4 m/s is 2 m more to the north, of which the relay goes half.
    assert ned_between(GROUND, guided.point)[:2] == pytest.approx((101.0, -50.0), abs=0.05)
    assert guided.yaw_rad is None
    assert guided.age_s == pytest.approx(0.5)


def test_a_ground_station_is_a_latitude_and_a_longitude() -> None:
    assert parse_ground("39.34,-86.03") == GlobalPosition(39.34, -86.03, 0.0)
    for text in ("", "39.34", "north,west", "91,0", "0,181", "nan,0"):
        with pytest.raises(EchowingError, match="LAT,LON"):
            parse_ground(text)


def test_what_cannot_be_relayed_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    ends = ["relay", "--remote", "udpin:1", "--vehicle", "udpin:2", "--ground", "39,-86"]
    assert main([*ends, "--rate", "1"]) == 2
    assert "--rate 1: give 2 to 20" in capsys.readouterr().err
