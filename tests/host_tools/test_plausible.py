"""The door through which messages enter: nothing that cannot be gets to the flight core."""

import ast
import math
import time
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from tests.flight.yard import FOLLOWER, Vehicle, Yard
from tests.host_tools.rig_desk import ScriptedWire, Speaker

import echowing
from echowing.flight.engage import APPLET, RTL
from echowing.mavlink.links import Link, parse_address
from echowing.mavlink.plausible import FIELDS, MOST_TOLD, PARAMETERS, Door, fault_of, printable
from echowing.mavlink.seats import OpenLink
from echowing.mavlink.vehicle_limits import BY_NAME, is_plausible
from echowing.rig.board import Board
from echowing.rig.view import wire_of
from echowing.setup.ftp import _entry

REAL32 = mavlink.MAV_PARAM_TYPE_REAL32
NUMBERS = [math.nan, math.inf, -math.inf]
KINDS = {one.msgname: one for one in mavlink.mavlink_map.values()}


def parameter(name: str, value: float) -> Any:
    return mavlink.MAVLink_param_value_message(name.encode(), value, REAL32, 1, 0)


def attitude(roll: float = 0.0, pitch: float = 0.0) -> Any:
    return mavlink.MAVLink_attitude_message(1_000, roll, pitch, 0.0, 0.0, 0.0, 0.0)


def received(system_id: int, message: Any, component: int = 1) -> Any:
    sender = mavlink.MAVLink(None, srcSystem=system_id, srcComponent=component)
    return mavlink.MAVLink(None).decode(bytearray(message.pack(sender)))


def blank(kind: str) -> Any:
    """A message of a kind, all zeros."""
    shape = KINDS[kind]
    zeros = {"char": b""}
    values = [zeros.get(one, 0.0 if one in ("float", "double") else 0) for one in shape.fieldtypes]
    lengths = [shape.array_lengths[shape.ordered_fieldnames.index(n)] for n in shape.fieldnames]
    filled = [
        [value] * length if length and value != b"" else value
        for value, length in zip(values, lengths, strict=True)
    ]
    return shape(*filled)


def read_kinds() -> set[str]:
    """The kinds of messages whose names stand in the code that reads them."""
    package = Path(echowing.__file__).parent
    folders = ("flight", "mavlink", "rig", "setup", "tool", "web")
    files = [path for folder in folders for path in (package / folder).glob("*.py")]
    trees = [ast.parse(path.read_text()) for path in files]
    constants = (
        node for tree in trees for node in ast.walk(tree) if isinstance(node, ast.Constant)
    )
    return {str(node.value) for node in constants} & set(KINDS)


class TestTable:
    def test_every_kind_that_is_read_is_in_it(self) -> None:
        assert read_kinds() >= {"ATTITUDE", "HEARTBEAT", "PARAM_VALUE", "RC_CHANNELS"}
        assert read_kinds() <= set(FIELDS)

    @pytest.mark.parametrize("kind", sorted(FIELDS))
    def test_no_float_of_a_kind_that_is_read_may_be_no_number(self, kind: str) -> None:
        """A new field of the dialect is checked too: nobody has to write it down."""
        shape = KINDS[kind]
        anything = {name for name, span in FIELDS[kind].items() if span == (-math.inf, math.inf)}
        floats = [
            name
            for name, one in zip(shape.fieldnames, shape.fieldtypes, strict=True)
            if one in ("float", "double") and name not in anything
        ]
        assert fault_of(blank(kind)) is None
        for name in floats:
            for number in NUMBERS:
                message = blank(kind)
                is_list = isinstance(getattr(message, name), list)
                setattr(message, name, [0.0, number] if is_list else number)
                assert fault_of(message) is not None, (kind, name, number)

    @pytest.mark.parametrize("kind", sorted(FIELDS))
    def test_each_span_is_of_a_field_that_exists_and_both_its_ends_hold(self, kind: str) -> None:
        for name, (least, most) in FIELDS[kind].items():
            assert name in KINDS[kind].fieldnames
            assert least < most
            if not math.isfinite(most):
                continue
            for value, well in ((least, True), (most, True), (least - 1, False), (most + 1, False)):
                message = blank(kind)
                setattr(message, name, value)
                assert (fault_of(message) is None) is well, (kind, name, value)

    def test_what_a_copter_in_flight_says_comes_in(self) -> None:
        vehicle, door = Vehicle((120.0, -40.0), (-14.0, 9.0)), Door()
        for message in (vehicle.position(5.0), *vehicle.reports(5.0)):
            assert door.admits(received(FOLLOWER, message))
        for name, value in vehicle.parameters.items():
            assert door.admits(received(FOLLOWER, parameter(name, value)))
        assert door.news == []


class TestDoor:
    def test_it_counts_each_and_tells_once_of_a_sender_and_a_field(self) -> None:
        door = Door()
        for _ in range(3):
            assert not door.admits(received(2, attitude(roll=math.nan)))
            assert not door.admits(received(3, attitude(roll=math.nan)))
            assert not door.admits(received(2, parameter("WP_ACC", 1e-30), component=191))
        assert door.refused == {"ATTITUDE": 6, "PARAM_VALUE": 3}
        assert door.summary == "6 ATTITUDE, 3 PARAM_VALUE"
        assert door.news == [
            "system 2: ATTITUDE.roll nan cannot be: not believed",
            "system 3: ATTITUDE.roll nan cannot be: not believed",
            "system 2, component 191: WP_ACC 1e-30 cannot be: not believed",
        ]

    def test_a_sender_of_many_kinds_of_nonsense_does_not_fill_the_screen(self) -> None:
        door = Door()
        for system_id in range(1, 200):
            door.admits(received(system_id, attitude(pitch=2.0)))
        assert len(door.news) == MOST_TOLD
        assert door.refused["ATTITUDE"] == 199

    def test_setup_sees_a_parameter_as_it_is_if_it_is_a_number(self) -> None:
        door = Door(parameters={})
        assert door.admits(received(2, parameter("WP_ACC", 1e-30)))
        assert not door.admits(received(2, parameter("WP_ACC", math.nan)))

    def test_no_name_on_a_card_moves_the_cursor(self) -> None:
        assert _entry(b"Fevil\x1b[2J.lua\t12").name == "evil[2J.lua"
        assert _entry(b"Dscripts\x07").name == "scripts"

    def test_no_text_of_a_link_moves_the_cursor_or_rings_the_bell(self) -> None:
        """An escape code in a STATUSTEXT reached the operator's terminal."""
        door = Door()
        text = received(
            2, mavlink.MAVLink_statustext_message(2, b"\x1b[2Jall is \x07well\r\x9b31m")
        )
        name = received(2, parameter("A\x1b[1mB", 1.0))
        assert door.admits(text)
        assert door.admits(name)
        assert (text.text, name.param_id) == ("[2Jall is well\ufffd31m", "A[1mB")
        assert printable("plain, as it is") == "plain, as it is"


class TestInFlight:
    def led(self, **parameters: float) -> Yard:
        there = Yard()
        there.vehicles[FOLLOWER].parameters.update(parameters)
        there.fly(8.0)
        return there

    @pytest.mark.parametrize("value", [1e-30, 0.0, -1.0, *NUMBERS])
    def test_an_acceleration_that_cannot_be_is_as_unknown(self, value: float) -> None:
        """With 1e-30 m/s2 the least slot was worked out for ever: no points, no word, no end."""
        there = self.led(WP_ACC=value)
        assert not there.session.followers[FOLLOWER].handling.known
        assert there.said("its acceleration and jerk are not known")

    @pytest.mark.parametrize("value", [1e-30, math.nan])
    def test_one_that_cannot_be_does_not_replace_the_one_that_is_known(self, value: float) -> None:
        there = self.led()
        assert there.state() == "following"
        there.tell(FOLLOWER, parameter("WP_ACC", value))
        assert len(there.fly(2.0)) == 16
        assert there.session.followers[FOLLOWER].handling.answer_in_calm.decel_mps2 == 5.0

    @pytest.mark.parametrize("roll_rad", [*NUMBERS, math.pi / 2.0, 1e6])
    def test_an_attitude_that_cannot_be_opens_no_slot(self, roll_rad: float) -> None:
        """With NaN the slot opened to 18.5 m for good, with infinity the tool ended."""
        there = self.led()
        for vehicle in there.vehicles.values():
            vehicle.velocity_mps = (2.0, 0.0)
            vehicle.pitch_rad = math.radians(-3.7)  # against the air, in calm
        opens_m = there.fly(2.0)[-1].afx
        assert opens_m < 4.0
        there.tell(FOLLOWER, attitude(roll=roll_rad))
        assert {point.afx for point in there.fly(8.0)} == {opens_m}
        assert there.state() == "following"

    def test_an_ekf_that_says_no_number_is_doubted(self) -> None:
        """Not believing the report would keep the healthy one before it."""
        there = self.led()
        there.vehicles[FOLLOWER].ekf_variance = math.nan
        there.fly(2.0)
        assert there.state() == "holding: it has an EKF that doubts its position"


class TestLinks:
    def test_every_link_has_the_door_before_anybody_listens(self) -> None:
        said: list[str] = []
        here, there = (
            OpenLink(Link(parse_address(f"{kind}:127.0.0.1:15987"))) for kind in ("udpin", "udpout")
        )
        here.link.open()
        there.link.open()
        try:
            for message in (attitude(roll=math.nan), attitude(roll=math.nan), attitude(0.5)):
                there.send(message, 0.0)
            heard: list[Any] = []
            until_s = time.monotonic() + 10.0
            while not heard and time.monotonic() < until_s:
                heard += here.receive(0.0, said.append)
        finally:
            here.link.close()
            there.link.close()
        assert [round(one.roll, 3) for one in heard] == [0.5]
        assert sum("ATTITUDE.roll nan" in text for text in said) == 1

    def test_the_rig_counts_what_cannot_be_and_shows_it(self) -> None:
        odd = mavlink.MAVLink_named_value_float_message(1, b"SNR_RAW", math.nan)
        wire = ScriptedWire((1.0, Speaker().say(odd)))
        board = Board(wire, (1, 191), name="/dev/ttyACM0", clock=wire.clock)
        assert board.poll(2.0) == []
        assert (board.frames.counts.frames, board.frames.counts.refused) == (1, 1)
        assert "1 refused: system 1, component 191: SNR_RAW nan" in wire_of(board)


def test_each_parameter_that_the_flight_core_reads_has_a_span() -> None:
    assert {*APPLET, *RTL, *BY_NAME} <= set(PARAMETERS)


@pytest.mark.parametrize("name", sorted(BY_NAME))
def test_the_door_and_the_flight_core_agree_on_the_ends_of_a_span(name: str) -> None:
    least, most = PARAMETERS[name]
    for value in (0.999 * least, 1.001 * least, 0.999 * most, 1.001 * most):
        assert (fault_of(received(2, parameter(name, value))) is None) is is_plausible(name, value)
