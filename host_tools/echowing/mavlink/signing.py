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
# pymavlink's names for bytes that begin no frame, and for a frame that it does not accept.
GARBAGE = "Bad prefix"
_REFUSED = "Invalid signature"
# Of a frame around its payload; with three bytes of it its length is known.
_V1_AROUND, _V2_AROUND, _SIGNATURE_BYTES = 8, 12, mavlink.MAVLINK_SIGNATURE_BLOCK_LEN
_LENGTH_KNOWN = 3
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
    """A parser that skips garbage; with a `LinkSigning` it accepts only signed messages.

    pymavlink believes the length in a frame's head: it waits for so many bytes, and drops them all
    if the checksum is wrong. On a radio that loses bytes that takes the next frames, too. This one
    goes back, and looks for a frame behind each head that proved wrong.
    """

    def __init__(self, signing: LinkSigning | None = None) -> None:
        super().__init__(None)
        self._damaged_to = 0  # in what waits: the end of the newest damaged frame
        if signing is not None:
            signing.apply(self)

    def parse_buffer(self, data: bytes) -> list[Any]:
        """The messages that end in these bytes; BAD_DATA: what is damaged, garbage, or refused."""
        waiting: bytearray = self.buf
        waiting.extend(data)
        found, at = [], 0
        while at < len(waiting):
            head = _head(waiting, at)
            # The rest of a damaged frame has been told of.
            if garbage := waiting[max(at, self._damaged_to) : head]:
                found.append(mavlink.MAVLink_bad_data(garbage, GARBAGE))
            at = head
            if at + _LENGTH_KNOWN > len(waiting) or at + _frame_bytes(waiting, at) > len(waiting):
                break
            end = at + _frame_bytes(waiting, at)
            found.append(self._decoded(waiting[at:end]))
            if found[-1].get_type() != "BAD_DATA" or is_refused(found[-1]):
                at = end
            else:
                at, self._damaged_to = at + 1, end
        self._damaged_to = max(0, self._damaged_to - at)
        del waiting[:at]
        return found

    def _decoded(self, frame: bytearray) -> Any:
        try:
            return self.decode(frame)
        except mavlink.MAVError as error:
            return mavlink.MAVLink_bad_data(frame, error.message)

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


def _head(data: bytearray, at: int) -> int:
    """The next place where a frame may begin; the end of the data: there is none."""
    while at < len(data) and not _may_begin(data, at):
        at += 1
    return at


def _may_begin(data: bytearray, at: int) -> bool:
    """Whether what has come of it may be the head of a frame, of a message that is known."""
    if data[at] == mavlink.PROTOCOL_MARKER_V1:
        return len(data) <= at + 5 or data[at + 5] in mavlink.mavlink_map
    if data[at] != mavlink.PROTOCOL_MARKER_V2:
        return False
    if len(data) > at + 2 and data[at + 2] & ~mavlink.MAVLINK_IFLAG_SIGNED:
        return False
    number = int.from_bytes(data[at + 7 : at + 10], "little")
    return len(data) < at + 10 or number in mavlink.mavlink_map


def _frame_bytes(data: bytearray, at: int) -> int:
    """How long the frame says to be that begins here."""
    if data[at] == mavlink.PROTOCOL_MARKER_V1:
        return _V1_AROUND + data[at + 1]
    signed = data[at + 2] & mavlink.MAVLINK_IFLAG_SIGNED
    return _V2_AROUND + data[at + 1] + (_SIGNATURE_BYTES if signed else 0)


def is_refused(message: Any) -> bool:
    """Whether a parser's answer is a complete frame that it did not accept."""
    return bool(message.get_type() == "BAD_DATA" and message.reason == _REFUSED)
