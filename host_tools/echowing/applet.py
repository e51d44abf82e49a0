"""The applet's way onto an autopilot's SD card."""

import os
import zlib
from pathlib import Path

from echowing.errors import EchowingError
from echowing.paths import lua_folder

APPLET = "echowing.lua"
# Where ArduPilot looks for scripts on its card (AP_Scripting, SCRIPTING_DIRECTORY).
FIRMWARE_FOLDER, SCRIPTS_FOLDER = "APM", "scripts"


def applet_path() -> Path:
    """The applet of this checkout."""
    return lua_folder() / APPLET


def install_on_card(mount: Path) -> Path:
    """Copy the applet into APM/scripts of the card mounted at `mount`, and read it back.

    An applet that is there already is replaced only once the new one is whole on the card.
    Raises EchowingError if `mount` is no autopilot's card, cannot be written, or gives back
    something else than was written.
    """
    folder = _scripts_folder(mount)
    target, arriving = folder / APPLET, folder / f"{APPLET}.new"
    try:
        wanted = applet_path().read_bytes()
        _write_through(arriving, wanted)
        _verify(arriving, wanted)
        arriving.replace(target)
    except OSError as error:
        raise EchowingError(
            f"{target}: cannot be written: {error.strerror}; is the card full or write-protected?"
        ) from error
    return target


def checksum(content: bytes) -> int:
    """CRC-32 of a file's content."""
    return zlib.crc32(content)


def _scripts_folder(mount: Path) -> Path:
    if not mount.is_dir():
        raise EchowingError(f"{mount}: no such folder; where is the card mounted?")
    if not (mount / FIRMWARE_FOLDER).is_dir():
        raise EchowingError(
            f"{mount}: no {FIRMWARE_FOLDER} folder, so not an autopilot's card; a new card gets "
            "one when the autopilot has been started with it"
        )
    folder = mount / FIRMWARE_FOLDER / SCRIPTS_FOLDER
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise EchowingError(f"{folder}: cannot be made: {error.strerror}") from error
    return folder


def _write_through(path: Path, content: bytes) -> None:
    """Written and on the card, not in this computer's memory only."""
    with path.open("wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())


def _verify(path: Path, wanted: bytes) -> None:
    found = path.read_bytes()
    if checksum(found) == checksum(wanted):
        return
    path.unlink()
    raise EchowingError(
        f"{path.parent}: the card gives back {len(found)} bytes with checksum "
        f"{checksum(found):08x} where {len(wanted)} with {checksum(wanted):08x} were written; "
        "try another card"
    )
