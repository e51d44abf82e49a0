"""Copies an applet to an autopilot's SD card."""

import os
import re
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from echowing.applets import HOLD, Applet, applets_among
from echowing.errors import EchowingError
from echowing.paths import shipped
from echowing.setup.ftp import FtpClient, FtpRefusedError, Progress
from echowing.setup.ftp_format import ardupilot_crc32

# Where ArduPilot looks for scripts on its card (AP_Scripting, SCRIPTING_DIRECTORY).
FIRMWARE_FOLDER, SCRIPTS_FOLDER = "APM", "scripts"
CARD_SCRIPTS = f"{FIRMWARE_FOLDER}/{SCRIPTS_FOLDER}"
# On a vehicle's card, and in ArduPilot's SITL, whose card is the folder it runs in.
CARD_FOLDERS = (CARD_SCRIPTS, SCRIPTS_FOLDER)
PARAMETER_PREFIX = "ECHO_"
# A row of an applet's table: name, default, lowest, highest, and its number for the autopilot.
_PARAMETER_ROW = re.compile(r"^(\w+) ([\d.]+) ([\d.]+) ([\d.]+) \d+$", re.MULTILINE)


def applet_path(applet: Applet = HOLD) -> Path:
    """An applet's file: of the release that was chosen, or as it comes with this package."""
    return applet.source or shipped(applet.file)


@dataclass(frozen=True, slots=True)
class AppletParameter:
    """One of an applet's parameters, from its table."""

    name: str
    default: float
    low: float
    high: float


def applet_parameters(applet: Applet = HOLD) -> list[AppletParameter]:
    """An applet's parameters."""
    return parameters_in(applet_path(applet))


def parameters_in(file: Path) -> list[AppletParameter]:
    """The parameters of an applet's file, read from its own table, the only place that lists them.

    Raises EchowingError for a file without one.
    """
    try:
        text = file.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise EchowingError(f"{file}: cannot read the applet: {error}") from error
    rows = [
        AppletParameter(f"{PARAMETER_PREFIX}{name}", *map(float, numbers))
        for name, *numbers in _PARAMETER_ROW.findall(text)
    ]
    if not rows:
        raise EchowingError(f"{file}: no table of parameters in it")
    return rows


def install_on_card(mount: Path, applet: Applet = HOLD, *, replace: bool = False) -> Path:
    """Copy an applet into APM/scripts of the card mounted at `mount`, and read it back.

    An older applet is replaced only when the new one is completely on the card; the other applet
    only if `replace` says so. Raises EchowingError if the other one is there, if `mount` is no
    autopilot's card, cannot be written, or does not return what was written.
    """
    folder = _scripts_folder(mount)
    target, arriving = folder / applet.file, folder / f"{applet.file}.new"
    others = others_among([file.name for file in folder.iterdir()], applet, replace=replace)
    try:
        wanted = applet_path(applet).read_bytes()
        _write_through(arriving, wanted)
        _verify(arriving, wanted)
        for name in others:
            (folder / name).unlink()
        arriving.replace(target)
    except OSError as error:
        raise EchowingError(
            f"{target}: cannot be written: {error.strerror}; is the card full or write-protected?"
        ) from error
    return target


def others_among(files: Sequence[str], applet: Applet, *, replace: bool) -> list[str]:
    """Files of applets that must leave before this one comes.

    Raises EchowingError if there are some and they may not be replaced.
    """
    of_applets = {one.file for one in applets_among(files) if one != applet}
    others = [file for file in files if file.lower() in of_applets]
    if others and not replace:
        raise EchowingError(
            f"{others[0]} is on the card, and a vehicle runs one applet: {applet.file} would "
            "replace it. Give --replace to do that"
        )
    return others


def install_over_link(
    card: FtpClient,
    progress: Callable[[str], Progress],
    scripts: str = CARD_SCRIPTS,
    applet: Applet = HOLD,
    *,
    replace: bool = False,
) -> bool:
    """Copy an applet to the folder `scripts` of an autopilot's card, over MAVLink.

    It is written beside the old one, checked by checksum and read back, and then replaces it. If
    anything fails, the card holds the complete old or the complete new applet, or none if power
    fails between two renames (FAT cannot rename onto a file). `progress` makes a progress bar
    with a title. The other applet leaves the card only if `replace` says so. False: the same applet
    is there already. Raises EchowingError.
    """
    wanted = applet_path(applet).read_bytes()
    target = f"{scripts}/{applet.file}"
    card.reset()
    _find_scripts(card, scripts)
    others = others_among(files_in(card, scripts), applet, replace=replace)
    arriving, leaving = f"{target}.new", f"{target}.old"
    if _is_whole(card, target, wanted):
        for name in (arriving, leaving, *(f"{scripts}/{other}" for other in others)):
            card.remove(name)
        return bool(others)
    try:
        card.upload(arriving, wanted, progress("writing"))
        _verify_on_card(card, arriving, wanted, progress("reading back"))
    except FtpRefusedError:
        card.reset()
        card.remove(arriving)
        raise
    for name in (leaving, *(f"{scripts}/{other}" for other in others)):
        card.remove(name)
    _replace(card, arriving, target, leaving)
    card.remove(leaving)
    return True


def files_in(card: FtpClient, folder: str) -> list[str]:
    """Names of the files in a folder of the card. Raises FtpRefusedError."""
    return [entry.name for entry in card.entries(folder) if not entry.is_folder]


def scripts_folder(card: FtpClient) -> str | None:
    """The vehicle's folder of scripts: on its SD card, or the one of ArduPilot's SITL.

    None: neither is there, as SITL makes the folder when scripting starts.
    """
    for folder, parent in ((CARD_SCRIPTS, FIRMWARE_FOLDER), (SCRIPTS_FOLDER, SCRIPTS_FOLDER)):
        try:
            card.entries(parent)
        except FtpRefusedError as refusal:
            if not refusal.not_there:
                raise
        else:
            return folder
    return None


def _find_scripts(card: FtpClient, scripts: str) -> None:
    """Check that there is a card, and make the folder on it."""
    parent = scripts.rpartition("/")[0]
    if parent:
        try:
            card.entries(parent)
        except FtpRefusedError as refusal:
            if not refusal.not_there:
                raise
            raise EchowingError(
                f"no folder {parent} on the vehicle: no SD card is in it, or the autopilot has "
                "not been started with the card yet"
            ) from refusal
    card.make_folder(scripts)


def _is_whole(card: FtpClient, path: str, wanted: bytes) -> bool:
    try:
        return card.checksum(path) == ardupilot_crc32(wanted)
    except FtpRefusedError as refusal:
        if refusal.not_there:
            return False
        raise


def _verify_on_card(card: FtpClient, path: str, wanted: bytes, progress: Progress) -> None:
    """Compare the autopilot's checksum and our own reading; remove the file if it differs."""
    found = card.checksum(path)
    whole = found in (None, ardupilot_crc32(wanted))
    if whole and card.download(path, progress) == wanted:
        return
    card.remove(path)
    raise EchowingError(
        f"{path}: the card does not return what was written; the older applet is still in "
        "place. Is the card full? If not, try another card"
    )


def _replace(card: FtpClient, arriving: str, target: str, leaving: str) -> None:
    """Swap the files; on failure restore the older one."""
    try:
        card.rename(target, leaving)
        had_one = True
    except FtpRefusedError as refusal:
        if not refusal.not_there:
            raise
        had_one = False
    try:
        card.rename(arriving, target)
    except FtpRefusedError:
        if had_one:
            card.rename(leaving, target)
        raise


def checksum(content: bytes) -> int:
    """CRC-32 of a file's content."""
    return zlib.crc32(content)


def _scripts_folder(mount: Path) -> Path:
    if not mount.is_dir():
        raise EchowingError(f"{mount}: no such folder; where is the card mounted?")
    if not (mount / FIRMWARE_FOLDER).is_dir():
        raise EchowingError(
            f"{mount}: no {FIRMWARE_FOLDER} folder, so this is not an autopilot's card; an "
            "autopilot makes the folder on a new card when it starts"
        )
    folder = mount / FIRMWARE_FOLDER / SCRIPTS_FOLDER
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise EchowingError(f"{folder}: cannot be created: {error.strerror}") from error
    return folder


def _write_through(path: Path, content: bytes) -> None:
    """Write, and flush to the card."""
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
