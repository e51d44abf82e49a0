"""A Mega's bootloader on a pseudo-terminal: STK500 version 2 (Atmel AVR068)."""

import os
import pty
import threading
import tty
from dataclasses import dataclass, field

START, TOKEN = 0x1B, 0x0E
SIGN_ON, SET_PARAMETER, GET_PARAMETER, LOAD_ADDRESS = 0x01, 0x02, 0x03, 0x06
ENTER, LEAVE, PROGRAM_FLASH, READ_FLASH = 0x10, 0x11, 0x13, 0x14
READ_SIGNATURE, SPI_MULTI = 0x1B, 0x1D
OK, UNKNOWN = 0x00, 0xC9
READ_SIGNATURE_INSTRUCTION = 0x30
ATMEGA2560 = bytes([0x1E, 0x98, 0x01])


@dataclass
class FakeProgrammer:
    """Answers on `port` until closed. `flash` is what has been written, by byte address."""

    signature: bytes = ATMEGA2560
    flash: dict[int, int] = field(default_factory=dict)
    left: bool = False  # programming mode was left in good order

    def __post_init__(self) -> None:
        self._master, slave = pty.openpty()
        tty.setraw(slave)
        self.port = os.ttyname(slave)
        self._slave = slave
        self._word_address = 0
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Pull the plug."""
        os.close(self._slave)
        self._thread.join(timeout=5)
        os.close(self._master)

    def image(self) -> bytes:
        """The flash from address 0 to the last byte written, gaps erased."""
        return bytes(self.flash.get(a, 0xFF) for a in range(max(self.flash, default=-1) + 1))

    def _serve(self) -> None:
        try:
            while True:
                self._answer_one()
        except OSError:  # the other end is closed
            return

    def _read(self, count: int) -> bytes:
        data = b""
        while len(data) < count:
            data += os.read(self._master, count - len(data))
        return data

    def _answer_one(self) -> None:
        if self._read(1)[0] != START:
            return
        header = self._read(4)
        sequence, length = header[0], int.from_bytes(header[1:3], "big")
        body = self._read(length)
        checksum = START ^ _xor(header) ^ _xor(body)
        if header[3] != TOKEN or self._read(1)[0] != checksum:
            return
        answer = bytes([body[0]]) + self._do(body)
        frame = bytes([START, sequence]) + len(answer).to_bytes(2, "big") + bytes([TOKEN]) + answer
        os.write(self._master, frame + bytes([_xor(frame)]))

    def _do(self, body: bytes) -> bytes:
        actions = {
            SIGN_ON: lambda _: bytes([OK, 8]) + b"STK500_2",
            GET_PARAMETER: lambda _: bytes([OK, 2]),
            SET_PARAMETER: lambda _: bytes([OK]),
            ENTER: lambda _: bytes([OK]),
            LEAVE: self._leave,
            LOAD_ADDRESS: self._load_address,
            PROGRAM_FLASH: self._program,
            READ_FLASH: self._read_back,
            READ_SIGNATURE: lambda body: bytes([OK, self.signature[body[4] % 3], OK]),
            SPI_MULTI: self._spi,
        }
        return actions.get(body[0], lambda _: bytes([UNKNOWN]))(body)

    def _leave(self, _: bytes) -> bytes:
        self.left = True
        return bytes([OK])

    def _load_address(self, body: bytes) -> bytes:
        self._word_address = int.from_bytes(body[1:5], "big") & 0x7FFFFFFF
        return bytes([OK])

    def _program(self, body: bytes) -> bytes:
        count = int.from_bytes(body[1:3], "big")
        data = body[10 : 10 + count]
        for offset, value in enumerate(data):
            self.flash[2 * self._word_address + offset] = value
        self._word_address += count // 2
        return bytes([OK])

    def _read_back(self, body: bytes) -> bytes:
        count, start = int.from_bytes(body[1:3], "big"), 2 * self._word_address
        data = bytes(self.flash.get(start + offset, 0xFF) for offset in range(count))
        self._word_address += count // 2
        return bytes([OK]) + data + bytes([OK])

    def _spi(self, body: bytes) -> bytes:
        """A raw programming instruction; the signature is read by 0x30 0x00 index."""
        wanted, start, sent = body[2], body[3], body[4:]
        value = self.signature[sent[2] % 3] if sent[0] == READ_SIGNATURE_INSTRUCTION else 0
        received = bytes([0, sent[0], sent[1], value])
        return bytes([OK]) + received[start : start + wanted] + bytes([OK])


def _xor(data: bytes) -> int:
    value = 0
    for byte in data:
        value ^= byte
    return value
