"""Battery, GPS, clock and switch of every vehicle in the view, the leader's mode and height."""

import io
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from rich.console import Console

from echowing.flight.guard import Limits
from echowing.flight.switch import StopSwitch
from echowing.tool.health import in_words, leaders_words
from echowing.tool.panel import HEALTH_FRESH_S, Panel, Row, VehicleHealth
from echowing.tool.view import LiveView

from ..flight.yard import FOLLOWER, LEADER, LOITER, Vehicle, Yard


class Watched(Yard):
    """A yard of which a panel hears all."""

    def __init__(self, **yard: Any) -> None:
        self.panel = Panel([LEADER, FOLLOWER])
        super().__init__(**yard)

    def tell(self, system_id: int, message: Any, component: int = 1) -> None:
        super().tell(system_id, message, component)
        sender = mavlink.MAVLink(None, srcSystem=system_id, srcComponent=component)
        received = mavlink.MAVLink(None).decode(bytearray(message.pack(sender)))
        self.panel.receive(received, self.now_s)

    def row(self) -> Row:
        (row,) = self.panel.rows(self.session, self.now_s)
        return row


def words(parts: list[tuple[str, str]]) -> str:
    return ", ".join(text for text, _ in parts)


def test_a_row_knows_what_a_pilot_lands_for() -> None:
    vehicles = {
        LEADER: Vehicle((0.0, 0.0), mode=LOITER, height_m=12.0, battery_percent=55),
        FOLLOWER: Vehicle((-4.0, 0.0)),
    }
    yard = Watched(vehicles=vehicles, limits=Limits(switch=StopSwitch(7, 1700)))
    yard.fly(2.0)
    boot_ms = vehicles[LEADER].boot_ms(yard.now_s)
    on = mavlink.MAVLink_rc_channels_message(boot_ms, 18, *[1900] * 18, 255)
    yard.tell(LEADER, on)
    row = yard.row()
    leader = "LOITER, 12.0 m up, GPS 3D 10, battery 55 % 12.6 V, clock 0.00 s, switch on"
    assert words(leaders_words(row.leader)) == leader
    its = "GPS 3D 10, battery 80 % 12.6 V, clock 0.00 s, switch not seen"
    assert words(in_words(row.own)) == its
    flat = row.as_dict()
    assert (flat["battery_percent"], flat["leader_battery_percent"]) == (80.0, 55.0)
    assert (flat["mode"], flat["leader_mode"]) == ("GUIDED", "LOITER")


def test_what_is_not_heard_of_late_is_not_known() -> None:
    yard = Watched()
    yard.fly(2.0)
    for vehicle in yard.vehicles.values():
        vehicle.silent = True
    yard.fly(HEALTH_FRESH_S + 1.0)
    row = yard.row()
    assert words(in_words(row.own)) == "GPS not known, battery not known, clock 0.00 s"
    assert words(leaders_words(row.leader)).startswith("mode not known, ")


def test_an_unknown_clock_and_words_for_not_known_are_no_numbers() -> None:
    yard = Watched()
    yard.vehicles[FOLLOWER].says_clock = False
    yard.vehicles[FOLLOWER].battery_percent = -1
    yard.fly(2.0)
    assert words(in_words(yard.row().own)) == "GPS 3D 10, battery 12.6 V, clock not known"


@pytest.mark.parametrize(
    ("one", "wrong"),
    [
        (VehicleHealth(gps="2D 5", battery_percent=50.0, clock_s=0.1), "GPS 2D 5"),
        (VehicleHealth(gps="none 0", battery_percent=50.0, clock_s=0.1), "GPS none 0"),
        (VehicleHealth(gps="3D 9", battery_percent=19.0, clock_s=0.1), "battery 19 %"),
        (VehicleHealth(gps="3D 9", battery_percent=50.0), "clock not known"),
        (
            VehicleHealth(gps="3D 9", battery_percent=50.0, clock_s=0.1, switch="was on"),
            "switch was on",
        ),
    ],
)
def test_what_is_wrong_stands_out(one: VehicleHealth, wrong: str) -> None:
    assert [text for text, style in in_words(one) if style] == [wrong]


def test_the_live_view_shows_a_line_a_vehicle() -> None:
    yard = Watched()
    yard.fly(2.0)
    output = io.StringIO()
    view = LiveView(Console(file=output, force_terminal=True, width=80, _environ={"TERM": "xterm"}))
    view.rows(1.0, [yard.row()])
    view.close()
    shown = "GPS 3D 10, battery 80 % 12.6 V, clock 0.00 s"
    assert f"leader: GUIDED, 10.0 m up, {shown}" in output.getvalue()
    assert f"2: {shown}" in output.getvalue()
