"""An STM32's boot loader in ROM on a pseudo-terminal (ST's application note AN3155)."""

import os
import pty
import threading
import tty
from dataclasses import dataclass, field

ACK, NACK, HELLO = b"\x79", b"\x1f", 0x7F
GET, VERSION, CHIP, READ, GO, WRITE, ERASE = 0x00, 0x01, 0x02, 0x11, 0x21, 0x31, 0x43
COMMANDS = bytes([GET, VERSION, CHIP, READ, GO, WRITE, ERASE])
F103_MEDIUM, PAGE = 0x410, 1024
FLASH_START = 0x08000000


@dataclass
class FakeRomLoader:
    """A Blue Pill with BOOT0 high on `port`, until closed. `flash` is what its flash holds."""

    flash: bytearray = field(default_factory=lambda: bytearray(b"\x5a" * 65536))
    erased_pages: list[int] = field(default_factory=list)
    started_at: int | None = None

    def __post_init__(self) -> None:
        self._master, self._slave = pty.openpty()
        tty.setraw(self._slave)
        self.port = os.ttyname(self._slave)
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Pull the plug."""
        os.close(self._slave)
        self._thread.join(timeout=5)
        os.close(self._master)

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

    def _say(self, data: bytes) -> None:
        os.write(self._master, data)

    def _answer_one(self) -> None:
        first = self._read(1)[0]
        if first == HELLO:
            self._say(ACK)
            return
        if self._read(1)[0] != first ^ 0xFF or first not in COMMANDS:
            self._say(NACK)
            return
        self._say(ACK)
        actions = {
            GET: lambda: self._say(bytes([len(COMMANDS), 0x22]) + COMMANDS + ACK),
            VERSION: lambda: self._say(bytes([0x22, 0, 0]) + ACK),
            CHIP: lambda: self._say(b"\x01" + F103_MEDIUM.to_bytes(2, "big") + ACK),
            READ: self._read_memory,
            GO: self._go,
            WRITE: self._write_memory,
            ERASE: self._erase,
        }
        actions[first]()

    def _address(self) -> int:
        address = self._place()
        self._say(ACK)
        return address

    def _place(self) -> int:
        return int.from_bytes(self._read(5)[:4], "big")  # the fifth is its checksum

    def _read_memory(self) -> None:
        start = self._address() - FLASH_START
        count = self._read(2)[0] + 1
        held = self.flash[start : start + count] if 0 <= start < len(self.flash) else bytes(count)
        self._say(ACK + bytes(held))

    def _go(self) -> None:
        # The tool ends with the answer: by then it has to be known.
        self.started_at = self._place()
        self._say(ACK)

    def _write_memory(self) -> None:
        start = self._address() - FLASH_START
        count = self._read(1)[0] + 1
        self.flash[start : start + count] = self._read(count)
        self._read(1)  # checksum
        self._say(ACK)

    def _erase(self) -> None:
        count = self._read(1)[0]
        pages = list(range(64)) if count == 0xFF else list(self._read(count + 1))
        self._read(1)  # checksum
        for page in pages:
            self.flash[page * PAGE : (page + 1) * PAGE] = b"\xff" * PAGE
        self.erased_pages += pages
        self._say(ACK)
