"""MAVLink 2 signing: keys from files, which messages a link accepts, times that never go back.

Facts from MAVLink's page on message signing: times count 10 us since 2015-01-01 and only ever
rise on one link of one sender; a link id tells the links of one sender apart.
"""

import hashlib
import stat
import string
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.errors import EchowingError

SIGNING_EPOCH_UNIX_S = 1_420_070_400  # 2015-01-01
SIGNING_TICKS_PER_S = 100_000
KEY_BYTES = 32
# Tools that may run at the same time sign under different link ids, else each makes the other's
# times look old. `follow` counts its links from 1; one verb of `setup` has one link.
SETUP_LINK_ID = 255
# A radio's own status messages carry no signature; ArduPilot accepts them all the same.
NEEDS_NO_SIGNATURE = {mavlink.MAVLINK_MSG_ID_RADIO, mavlink.MAVLINK_MSG_ID_RADIO_STATUS}
# pymavlink's name for a frame that it does not accept.
_REFUSED = "Invalid signature"
_PRINTABLE = frozenset(string.printable.encode())


def read_key(path: Path | None) -> bytes | None:
    """The key of `--signing-key-file`, None without one; warns on stderr."""
    return None if path is None else load_key(path, lambda text: print(text, file=sys.stderr))


def load_key(path: Path, warn: Callable[[str], None]) -> bytes:
    """Read a key: 32 bytes as they are, 64 hexadecimal digits, or a pass phrase.

    A phrase becomes a key by SHA-256, as ground stations make it. `warn` gets a message about a
    file that others may read. Raises EchowingError.
    """
    try:
        content = path.read_bytes()
        mode = path.stat().st_mode
    except OSError as error:
        raise EchowingError(f"--signing-key-file {path}: {error.strerror}") from error
    if mode & (stat.S_IRWXG | stat.S_IRWXO):
        warn(f"{path} is open to others; with its key they can fly the vehicles: chmod 600 {path}")
    return _key_of(content, path)


def _key_of(content: bytes, path: Path) -> bytes:
    printable = all(byte in _PRINTABLE for byte in content)
    if len(content) == KEY_BYTES and not printable:
        return content
    phrase = content.strip(b"\r\n")
    if not phrase or not (printable or _is_text(phrase)):
        raise EchowingError(
            f"--signing-key-file {path}: holds no key; write {KEY_BYTES} bytes, "
            f"{2 * KEY_BYTES} hexadecimal digits or a pass phrase into it"
        )
    try:
        key = bytes.fromhex(phrase.decode())
    except ValueError:
        key = b""
    return key if len(key) == KEY_BYTES else hashlib.sha256(phrase).digest()


def _is_text(content: bytes) -> bool:
    try:
        return content.decode("utf-8").isprintable()
    except UnicodeDecodeError:
        return False


class LinkSigning:
    """Signing on one link, shared by its packer and its parser.

    Received messages advance the time: otherwise a clock ahead of ours would refuse our messages.
    `unix_clock` is UTC seconds.
    """

    def __init__(
        self, key: bytes, link_id: int, unix_clock: Callable[[], float] = time.time
    ) -> None:
        self._state = mavlink.MAVLinkSigning()
        self._state.secret_key = key
        self._state.link_id = link_id
        self._state.sign_outgoing = True
        self._state.allow_unsigned_callback = lambda mav, number: number in NEEDS_NO_SIGNATURE
        self._unix_clock = unix_clock

    def apply(self, mav: Any) -> None:
        """Sign what `mav` packs, and let it accept only signed messages."""
        mav.signing = self._state

    def keep_time(self) -> None:
        """Advance the time to now; never back, whatever the computer's clock does."""
        ticks = round((self._unix_clock() - SIGNING_EPOCH_UNIX_S) * SIGNING_TICKS_PER_S)
        self._state.timestamp = max(self._state.timestamp, ticks)


class Parser(mavlink.MAVLink):  # type: ignore[misc]
    """A parser that skips garbage; with a `LinkSigning` it accepts only signed messages."""

    def __init__(self, signing: LinkSigning | None = None) -> None:
        super().__init__(None)
        self.robust_parsing = True
        if signing is not None:
            signing.apply(self)

    def check_signature(self, msgbuf: bytearray, srcSystem: int, srcComponent: int) -> bool:  # noqa: N803
        """As pymavlink, but a forged frame has no effect.

        pymavlink notes a frame's time before it looks at the signature, so that one forged frame
        with a time in the future would block the real sender.
        """
        times = self.signing.stream_timestamps
        stream = (msgbuf[-13], srcSystem, srcComponent)
        before = times.get(stream)
        good = bool(super().check_signature(msgbuf, srcSystem, srcComponent))
        if not good and before is None:
            times.pop(stream, None)
        elif not good:
            times[stream] = before
        return good


def is_refused(message: Any) -> bool:
    """Whether a parser's answer is a complete frame that it did not accept."""
    return bool(message.get_type() == "BAD_DATA" and message.reason == _REFUSED)
