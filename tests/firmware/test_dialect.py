"""The trimmed dialect speaks the common MAVLink: same ids, same layouts, same checksums."""

from pathlib import Path

import pytest
from pymavlink.dialects.v20 import ardupilotmega
from pymavlink.generator import mavparse

DIALECT = Path(__file__).resolve().parents[2] / "firmware" / "dialect" / "echowing.xml"


def messages() -> list[mavparse.MAVType]:
    xml = mavparse.MAVXML(str(DIALECT), mavparse.PROTOCOL_2_0)
    return list(xml.message)


@pytest.mark.parametrize("ours", messages(), ids=lambda message: message.name)
def test_message_is_the_common_one(ours: mavparse.MAVType) -> None:
    theirs = ardupilotmega.mavlink_map[ours.id]
    assert theirs.msgname == ours.name
    assert theirs.crc_extra == ours.crc_extra
    assert theirs.fieldnames == [field.name for field in ours.fields]
    assert theirs.unpacker.size == ours.wire_length


def test_enumerations_have_the_common_values() -> None:
    xml = mavparse.MAVXML(str(DIALECT), mavparse.PROTOCOL_2_0)
    entries = [entry for enum in xml.enum for entry in enum.entry]
    named = [entry for entry in entries if not entry.end_marker]
    assert len(named) > 20
    for entry in named:
        assert getattr(ardupilotmega, entry.name) == entry.value, entry.name
