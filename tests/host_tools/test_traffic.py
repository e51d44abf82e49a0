"""What a flight's radios carried, counted from its log."""

import subprocess
import sys
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.analysis.traffic import text, traffic
from echowing.errors import EchowingError
from echowing.mavlink.messages import TOOL_COMPONENT_ID, TOOL_SYSTEM_ID


def log(path: Path, seconds: int) -> Path:
    """Heartbeats of a vehicle at 2 Hz and requests of the tool at 1 Hz."""
    vehicle = mavlink.MAVLink(None, srcSystem=7)
    tool = mavlink.MAVLink(None, srcSystem=TOOL_SYSTEM_ID, srcComponent=TOOL_COMPONENT_ID)
    with path.open("wb") as file:
        for half in range(2 * seconds + 1):
            stamp = (1_800_000_000_000_000 + half * 500_000).to_bytes(8, "big")
            beat = mavlink.MAVLink_heartbeat_message(2, 3, 129, 4, 4, 3)
            file.write(stamp + beat.pack(vehicle))
            if half % 2:
                ask = mavlink.MAVLink_command_long_message(7, 1, 512, 0, *(1.0,) * 7)
                file.write(stamp + ask.pack(tool))
    return path


def test_traffic_is_counted_by_way_and_message(tmp_path: Path) -> None:
    rows = traffic(log(tmp_path / "f.tlog", 30), skipped_s=10.0)
    counted = {(row.way, row.message): (row.per_s, row.bytes_ps) for row in rows}
    # MAVLink 2: 10 bytes of header, 2 of check sum; 9 of heartbeat and 33 of command, of which
    # the confirmation, 0, is not the last and so not cut.
    assert counted["from system 7", "HEARTBEAT"] == pytest.approx((2.0, 42.0), rel=0.05)
    assert counted["to system 7", "COMMAND_LONG"] == pytest.approx((1.0, 44.0), rel=0.1)
    assert "| **from system 7** | **sum** |" in text(rows)


def test_a_log_without_a_flight_is_refused(tmp_path: Path) -> None:
    with pytest.raises(EchowingError, match="less than 11 s"):
        traffic(log(tmp_path / "f.tlog", 5))
    command = [sys.executable, "-m", "echowing.analysis.traffic", str(tmp_path / "none.tlog")]
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (run.returncode, "no such file" in run.stderr) == (1, True)
    assert "Traceback" not in run.stderr
