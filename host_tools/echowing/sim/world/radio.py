"""A radio link, one way: frames go in, and come out late, some lost, some cut, some reordered."""

import heapq
import random
from dataclasses import dataclass
from itertools import count

from echowing.sim.world.cutter import ByteLoss, PacketCutter


@dataclass(frozen=True, slots=True)
class RadioSettings:
    """How bad a link is.

    latency_s: from in to out; jitter_s: added, evenly spread from 0; loss: share of packets that
    never arrive; bandwidth_bytes_ps: what it carries (None: anything); reorder: share of packets
    delayed by `reorder_s` more, so that later ones overtake them; duplicate: share that arrives
    twice, the second time with the delay of another packet.
    """

    latency_s: float = 0.0
    jitter_s: float = 0.0
    loss: float = 0.0
    bandwidth_bytes_ps: float | None = None
    reorder: float = 0.0
    reorder_s: float = 0.3
    duplicate: float = 0.0


class Radio:
    """One direction of a link. Packets are whole MAVLink frames, until `cutter` cuts them."""

    def __init__(
        self, settings: RadioSettings, rng: random.Random, cutter: PacketCutter | None = None
    ) -> None:
        self.settings = settings
        self.cutter = cutter or PacketCutter(ByteLoss(), rng)
        self.silent = False  # the vehicle's radio is off: nothing gets through
        self.outage = False  # a fault in between, with the same effect
        self._rng = rng
        self._flying: list[tuple[float, int, bytes]] = []
        self._number = count()
        self._free_at_s = 0.0
        self._newest_out_s = 0.0

    def send(self, t_s: float, packet: bytes) -> None:
        """Put a packet in at `t_s`."""
        settings = self.settings
        if self.silent or self.outage or (settings.loss and self._rng.random() < settings.loss):
            return
        self._carry(t_s, packet)
        if settings.duplicate and self._rng.random() < settings.duplicate:
            self._carry(t_s, packet)

    def _carry(self, t_s: float, packet: bytes) -> None:
        settings = self.settings
        arrives_s = self._sent_at(t_s, len(packet)) + settings.latency_s
        if settings.jitter_s:
            arrives_s += self._rng.uniform(0.0, settings.jitter_s)
        if settings.reorder and self._rng.random() < settings.reorder:
            arrives_s += settings.reorder_s
        else:
            # Jitter alone keeps the order, as a serial link does.
            self._newest_out_s = arrives_s = max(arrives_s, self._newest_out_s)
        left = self.cutter.carry(packet, t_s)
        heapq.heappush(self._flying, (arrives_s, next(self._number), left))

    def receive(self, t_s: float) -> list[bytes]:
        """What has arrived by `t_s`, in order of arrival, a packet each; once cut, any bytes."""
        arrived = []
        while self._flying and self._flying[0][0] <= t_s:
            arrived.append(heapq.heappop(self._flying)[2])
        return arrived

    def _sent_at(self, t_s: float, size: int) -> float:
        if self.settings.bandwidth_bytes_ps is None:
            return t_s
        self._free_at_s = max(self._free_at_s, t_s) + size / self.settings.bandwidth_bytes_ps
        return self._free_at_s
