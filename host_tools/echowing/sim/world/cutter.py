"""A radio as its bytes meet it: it cuts them into packets of its own, and loses packets.

A telemetry radio knows no frames. When its turn comes it sends what waits in its buffer, and the
packet that is lost takes the end of one frame and the beginning of the next with it.
"""

import random
from dataclasses import dataclass

# A packet does not wait longer for more bytes: about what a SiK radio's turns on the air are apart.
WAITS_S = 0.05


@dataclass(frozen=True, slots=True)
class ByteLoss:
    """How bad a link is to its bytes.

    byte_loss: share of the packets lost; packet_bytes: least and most bytes of a packet, each
    length as likely; flip: share of the packets that arrive with one wrong bit.
    """

    byte_loss: float = 0.0
    packet_bytes: tuple[int, int] = (20, 80)
    flip: float = 0.0


class PacketCutter:
    """One direction of a link: bytes go in, and what is left of them comes out at once.

    `loss` may be replaced at any time. `has_cut`: it has been at work, so that what comes out need
    not be whole frames any more.
    """

    def __init__(self, loss: ByteLoss, rng: random.Random) -> None:
        self.loss = loss
        self.has_cut = False
        self._rng = rng
        self._left = 0  # bytes of the packet under way that may still come
        self._fed_s = 0.0
        self._lost = False
        self._wrong: tuple[int, int] | None = None  # bytes left after the one that is wrong; bit

    def carry(self, data: bytes, t_s: float = 0.0) -> bytes:
        """What arrives of `data`, sent at `t_s`; without times it is all one stream."""
        if t_s - self._fed_s > WAITS_S:
            self._left = 0
        self._fed_s = t_s
        if not (self.loss.byte_loss or self.loss.flip):
            self._left = 0
            return data
        self.has_cut = True
        arrived = bytearray()
        at = 0
        while at < len(data):
            if not self._left:
                self._begin_packet()
            piece = data[at : at + self._left]
            at += len(piece)
            self._left -= len(piece)
            if not self._lost:
                arrived += self._with_wrong_bit(piece)
        return bytes(arrived)

    def _begin_packet(self) -> None:
        chance, loss = self._rng, self.loss
        self._left = chance.randint(*loss.packet_bytes)
        self._lost = chance.random() < loss.byte_loss
        flips = chance.random() < loss.flip
        self._wrong = (chance.randrange(self._left), chance.randrange(8)) if flips else None

    def _with_wrong_bit(self, piece: bytes) -> bytes:
        """The piece of the packet that has just come, with the wrong bit if it is in there."""
        if self._wrong is None:
            return piece
        after, bit = self._wrong
        at = self._left + len(piece) - 1 - after
        if not 0 <= at < len(piece):
            return piece
        return piece[:at] + bytes([piece[at] ^ 1 << bit]) + piece[at + 1 :]
