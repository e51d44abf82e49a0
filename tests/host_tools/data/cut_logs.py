"""Cut a short excerpt out of a recorded flight, with only the messages the analysis reads.

    python cut_logs.py RECORDING_FOLDER 1795224450 20

reads leader and follower .tlog and .BIN and truth.csv there and writes the excerpts beside this
file. The bytes of each kept message are those of the recording.
"""

import csv
import struct
import sys
from pathlib import Path
from typing import Any

from pymavlink import DFReader, mavutil

from echowing.analysis.vehicle_log import AUTOPILOT_COMPONENT, DATAFLASH_TYPES, TLOG_TYPES

HERE = Path(__file__).parent
# Needed once, from the start of the recording, whatever part is cut out.
PARAMETERS = {"MAV_SYSID", "WP_SPD"}


def cut_tlog(source: Path, target: Path, start_s: float, end_s: float) -> None:
    """By the time of reception."""
    log = mavutil.mavlink_connection(str(source), dialect="ardupilotmega")
    with target.open("wb") as file:
        while (message := log.recv_match(type=TLOG_TYPES)) is not None:
            if start_s <= message._timestamp <= end_s and _wanted(message):
                stamp_us = round(message._timestamp * 1e6)
                file.write(struct.pack(">Q", stamp_us) + bytes(message.get_msgbuf()))


def _wanted(message: Any) -> bool:
    if message.get_type() == "DISTANCE_SENSOR":
        return bool(message.get_srcComponent() != AUTOPILOT_COMPONENT)  # not the copy of it
    return bool(message.get_type() != "PARAM_VALUE")


def cut_dataflash(source: Path, target: Path, start_s: float, end_s: float) -> None:
    """By the vehicle's clock; formats, version, mode and system id come from the beginning."""
    log = DFReader.DFReader_binary(str(source), zero_time_base=False)
    with target.open("wb") as file:
        while (message := log.recv_match(type=[*DATAFLASH_TYPES, "FMT"])) is not None:
            if _keep(message, start_s, end_s):
                file.write(bytes(message.get_msgbuf()))


def _keep(message: Any, start_s: float, end_s: float) -> bool:
    kind = message.get_type()
    if kind == "FMT":
        return message.Name in {*DATAFLASH_TYPES, "FMT"}
    if kind == "PARM":
        return message.Name in PARAMETERS
    if kind in ("RTC", "MODE"):
        return True
    if kind == "MSG":
        return "Copter" in message.Message
    if kind == "XKF1" and message.C != 0:
        return False
    return bool(start_s <= message._timestamp <= end_s)


def cut_truth(source: Path, target: Path, start_s: float, end_s: float) -> None:
    """The rows of that time."""
    with source.open(newline="") as file, target.open("w", newline="") as out:
        reader = csv.reader(file)
        writer = csv.writer(out)
        writer.writerow(next(reader))
        writer.writerows(row for row in reader if start_s <= float(row[0]) <= end_s)


def main() -> None:
    """Cut all five files."""
    folder, start_s, length_s = Path(sys.argv[1]), float(sys.argv[2]), float(sys.argv[3])
    end_s = start_s + length_s
    for name in ("leader", "follower"):
        cut_tlog(folder / f"{name}.tlog", HERE / f"{name}.tlog", start_s, end_s)
        cut_dataflash(folder / f"{name}.BIN", HERE / f"{name}.BIN", start_s, end_s)
    cut_truth(folder / "truth.csv", HERE / "truth.csv", start_s, end_s)


if __name__ == "__main__":
    main()
