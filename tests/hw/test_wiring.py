"""The wiring says the same as the firmware's pin table, and the copper goes where it must."""

import re
from collections.abc import Iterable
from pathlib import Path
from xml.etree import ElementTree

import pytest

from hwtools import sheet, wiring
from hwtools.facts import HardwareError, firmware_pins

Pin = tuple[str, str]  # connector, pin's label

# our role names: the firmware's
ROLES = {
    "SDA": "i2c_data",
    "SCL": "i2c_clock",
    "PAN": "pan",
    "TILT": "tilt",
    "AP_TX": "link_tx",
    "AP_RX": "link_rx",
    "LED": "led",
}
# Pixhawk connector standard DS-009, telemetry port
TELEM_ORDER = ["5V", "TX (out)", "RX (in)", "CTS (in)", "RTS (out)", "GND"]
FIVE_VOLT_BOARDS = [b for b in wiring.BOARDS if wiring.board_sheet(b)["metadata"]["logic_v"] == 5.0]

three_volt_boards = pytest.mark.parametrize(
    "board", [b for b in wiring.BOARDS if b not in FIVE_VOLT_BOARDS]
)
every_board = pytest.mark.parametrize("board", wiring.BOARDS)


def copper(board: str) -> list[set[Pin]]:
    """Everything that is one piece of metal; level shifter and resistors keep pieces apart."""
    harness = wiring.draw(board, wiring.OVERVIEW)
    label = {
        (name, pin): str(text)
        for name, connector in harness.connectors.items()
        for pin, text in zip(connector.pins, connector.pinlabels, strict=True)
    }
    nets: list[set[Pin]] = []
    for name, cable in harness.cables.items():
        for wire in cable.connections:
            join(
                nets,
                [(name, str(wire.via_port))]
                + [
                    (end, label[end, pin])
                    for end, pin in ((wire.from_name, wire.from_pin), (wire.to_name, wire.to_pin))
                    if end is not None
                ],
            )
    join(nets, [("JP1", "TELEM 5V"), ("JP1", "board 5V")])  # jumper in place
    for shifter in ("SHIFTER", "BUS_SHIFTER"):  # joined on the module
        if shifter in harness.connectors:
            join(nets, [(shifter, "HV GND"), (shifter, "LV GND")])
    return nets


def join(nets: list[set[Pin]], pins: Iterable[Pin]) -> None:
    merged = set(pins)
    for net in [net for net in nets if net & merged]:
        nets.remove(net)
        merged |= net
    nets.append(merged)


def net_of(board: str, pin: Pin) -> set[Pin]:
    return next((net for net in copper(board) if pin in net), {pin})


def test_wiring_and_firmware_know_the_same_boards() -> None:
    assert set(wiring.BOARDS) == set(firmware_pins())


@every_board
def test_pins_are_the_firmwares(board: str) -> None:
    table, drawn = firmware_pins()[board], wiring.board_pins(board)
    assert {role: drawn[role] for role in ROLES} == {role: table[ROLES[role]] for role in ROLES}


@every_board
def test_led_is_wired_for_the_level_that_lights_it(board: str) -> None:
    wanted = {"HIGH": "led_high", "LOW": "led_low"}[firmware_pins()[board]["led_on_level"]]
    assert [name for name in wiring.harnesses(board) if name.startswith("led")] == [wanted]


@every_board
def test_led_current_flows_the_right_way(board: str) -> None:
    lit_high = "led_high" in wiring.harnesses(board)
    assert ("LED", "anode" if lit_high else "cathode") in net_of(board, ("BOARD", "LED"))
    other = ("BOARD", "GND") if lit_high else ("BOARD", "3V3")
    assert ("LED", "cathode" if lit_high else "anode") in net_of(board, other)


@every_board
def test_sonar_gets_ground_and_filtered_supply(board: str) -> None:
    assert ("BOARD", "GND") in net_of(board, ("SONAR", "GND"))
    assert ("FILTER", "V+ out") in net_of(board, ("SONAR", "V+"))
    assert ("FILTER", "5V in") not in net_of(board, ("SONAR", "V+")), "R1 is bridged"


@pytest.mark.parametrize("board", FIVE_VOLT_BOARDS)
def test_bus_of_a_5v_board_goes_straight_to_the_sonar(board: str) -> None:
    for role in ("SDA", "SCL"):
        assert ("BOARD", role) in net_of(board, ("SONAR", role))


@three_volt_boards
def test_bus_of_a_3v3_board_passes_its_shifter(board: str) -> None:
    for role in ("SDA", "SCL"):
        low = {pin for name, pin in net_of(board, ("BOARD", role)) if name == "BUS_SHIFTER"}
        high = {pin for name, pin in net_of(board, ("SONAR", role)) if name == "BUS_SHIFTER"}
        assert {pin.replace("LV", "HV") for pin in low} == high != set()
        assert ("BOARD", role) not in net_of(board, ("SONAR", role)), "3.3 V on the sonar's bus"
    assert ("BUS_SHIFTER", "LV 3V3") in net_of(board, ("BOARD", "3V3"))
    assert ("BUS_SHIFTER", "HV V+") in net_of(board, ("SONAR", "V+")), "above the sonar's supply"
    assert ("BUS_SHIFTER", "HV GND") in net_of(board, ("BOARD", "GND"))


@every_board
def test_only_soft_wires_move_with_the_gimbal(board: str) -> None:
    """The stiff shielded lead ends at the clamp."""
    cables = wiring.draw(board, wiring.OVERVIEW).cables
    ends = {wire.to_name for wire in cables["W_SONAR"].connections if wire.to_name}
    assert ends == {"SONAR_JOINT"}
    assert (cables["W_SONAR_TAIL"].gauge, cables["W_SONAR_TAIL"].type) == (
        "30",
        "silicone, soft, twisted",
    )


@every_board
def test_shield_is_grounded_at_one_end_only(board: str) -> None:
    harness = wiring.draw(board, "sonar_lead")
    ends = [w for w in harness.cables["W_SONAR"].connections if w.via_port == "s"]
    assert [(end.from_name, end.to_name) for end in ends] == [("FILTER", None)]
    assert ("BOARD", "GND") in net_of(board, ("W_SONAR", "s"))


@every_board
def test_servos_have_their_own_supply_and_the_common_ground(board: str) -> None:
    supply = net_of(board, ("RAIL", "5V servo"))
    assert {("PAN_SERVO", "5V"), ("TILT_SERVO", "5V"), ("BEC", "5V out")} <= supply
    assert ("BOARD", "5V") not in supply
    ground = net_of(board, ("BOARD", "GND"))
    for pin in ("PAN_SERVO", "TILT_SERVO", "SONAR", "TELEM2"):
        assert (pin, "GND") in ground
    assert ("BEC", "GND out") in ground


@pytest.mark.parametrize("board", FIVE_VOLT_BOARDS)
def test_servo_pulses_of_a_5v_board_come_from_their_pins(board: str) -> None:
    assert ("PAN_SERVO", "signal") in net_of(board, ("BOARD", "PAN"))
    assert ("TILT_SERVO", "signal") in net_of(board, ("BOARD", "TILT"))


@three_volt_boards
def test_servo_pulses_of_a_3v3_board_pass_the_buffer(board: str) -> None:
    for role, gate in (("PAN", "1"), ("TILT", "2")):
        assert ("BUFFER", f"{gate}A") in net_of(board, ("BOARD", role))
        assert ("BUFFER", f"{gate}Y") in net_of(board, (f"{role}_SERVO", "signal"))
    assert ("BUFFER", "VCC") in net_of(board, ("RAIL", "5V servo")), "pulses above their supply"
    assert ("BUFFER", "GND") in net_of(board, ("BOARD", "GND"))
    # SN74AHCT125, DIP-14
    buffer = wiring.draw(board, wiring.OVERVIEW).connectors["BUFFER"]
    pins = dict(zip(buffer.pinlabels, buffer.pins, strict=True))
    assert pins == {"VCC": 14, "GND": 7, "1A": 2, "1Y": 3, "2A": 5, "2Y": 6}


@three_volt_boards
def test_link_crosses_on_a_3v3_board(board: str) -> None:
    assert ("TELEM2", "RX (in)") in net_of(board, ("BOARD", "AP_TX"))
    assert ("TELEM2", "TX (out)") in net_of(board, ("BOARD", "AP_RX"))


@pytest.mark.parametrize("board", FIVE_VOLT_BOARDS)
def test_link_of_a_5v_board_passes_the_level_shifter(board: str) -> None:
    for ours, theirs in (("AP_TX", "RX (in)"), ("AP_RX", "TX (out)")):
        high = {pin for name, pin in net_of(board, ("BOARD", ours)) if name == "SHIFTER"}
        low = {pin for name, pin in net_of(board, ("TELEM2", theirs)) if name == "SHIFTER"}
        assert {pin.replace("HV", "LV") for pin in high} == low != set()
        assert ("BOARD", ours) not in net_of(board, ("TELEM2", theirs)), "5 V on a 3.3 V port"
    assert ("SHIFTER", "HV 5V") in net_of(board, ("BOARD", "5V"))
    assert ("SHIFTER", "LV 3V3") in net_of(board, ("BOARD", "3V3"))


@every_board
def test_telem_plug_has_the_standards_order_and_no_flow_control(board: str) -> None:
    plug = wiring.draw(board, wiring.OVERVIEW).connectors["TELEM2"]
    assert (plug.pins, plug.pinlabels) == ([1, 2, 3, 4, 5, 6], TELEM_ORDER)
    for pin in ("CTS (in)", "RTS (out)"):
        assert net_of(board, ("TELEM2", pin)) == {("TELEM2", pin)}
    assert ("TELEM2", "5V") in net_of(board, ("BOARD", "5V"))


@every_board
def test_pullups_go_to_the_sonars_own_supply(board: str) -> None:
    notes = wiring.draw(board, wiring.OVERVIEW).connectors["FILTER"].notes
    assert "R2 4.7 kohm from SDA to V+ out" in notes
    assert "R3 4.7 kohm from SCL to V+ out" in notes


def test_a_wire_to_nowhere_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    read = wiring.read_sheet

    def with_misprint(path: Path) -> wiring.Sheet:
        sheet = read(path)
        if path.stem == "usb":
            sheet["connections"][0][0] = {"BOARD_UBS": ["5V", "D-", "D+", "GND"]}
        return sheet

    monkeypatch.setattr(wiring, "read_sheet", with_misprint)
    with pytest.raises(HardwareError, match=r"mega, usb.*BOARD_UBS"):
        wiring.draw("mega", "usb")


@pytest.mark.parametrize("board", wiring.BOARDS)
def test_the_sheet_has_every_wire_in_letters_that_can_be_read(board: str) -> None:
    """Drawn 900 wide, as wide as a page shows it, with letters of 13 and more."""
    root = ElementTree.fromstring(sheet.svg_text(board))
    assert float(root.attrib["width"]) <= 900.0
    name = "{http://www.w3.org/2000/svg}text"
    sizes = [float(node.attrib.get("font-size", 14.0)) for node in root.iter(name)]
    assert min(sizes) >= 13.0
    texts = [node.text or "" for node in root.iter(name)]
    wires = sum(
        len(cable.connections) for cable in wiring.draw(board, wiring.OVERVIEW).cables.values()
    )
    assert sum(bool(re.fullmatch(r"[A-Z]{2}|shield", text)) for text in texts) == wires
    # Arial is about half as wide as high: what stands left of the wires stays on the sheet.
    assert all(len(text) * 7.0 < 340.0 for text in texts if text.endswith(")"))
