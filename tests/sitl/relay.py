"""A telemetry link between a tool and a vehicle: late, cut, or losing packets of its own."""

import contextlib
import heapq
import random
import select
import socket
import threading
import time

from echowing.sim.world.cutter import ByteLoss, PacketCutter

LOOPBACK = "127.0.0.1"
CHUNK_BYTES = 65_536
LONGEST_SLEEP_S = 0.02
RETRY_S = 0.5


class Queue:
    """Bytes on their way: each chunk comes out `delay_s` after it went in. Pure."""

    def __init__(self, delay_s: float) -> None:
        self.delay_s = delay_s
        self._late: list[tuple[float, int, bytes]] = []
        self._count = 0

    def put(self, now_s: float, data: bytes) -> None:
        """Send; in order, as a radio sends."""
        self._count += 1
        heapq.heappush(self._late, (now_s + self.delay_s, self._count, data))

    def take(self, now_s: float) -> bytes:
        """What has arrived by now."""
        arrived = []
        while self._late and self._late[0][0] <= now_s:
            arrived.append(heapq.heappop(self._late)[2])
        return b"".join(arrived)

    def due_s(self) -> float | None:
        """When the next chunk arrives."""
        return self._late[0][0] if self._late else None

    def clear(self) -> None:
        """What is on its way is lost."""
        self._late.clear()


class Link:
    """A vehicle's TCP port on another port, `delay_s` late each way.

    While `cut` is set nothing passes and what is on its way is lost, as on a radio out of range;
    the connections stay. `lose` makes it a radio that loses packets, which it cuts anywhere.
    """

    def __init__(self, vehicle_port: int, delay_s: float) -> None:
        self._vehicle_port = vehicle_port
        self._listener = socket.create_server((LOOPBACK, 0))
        self._listener.setblocking(False)
        self.port = int(self._listener.getsockname()[1])
        self.cut = threading.Event()
        self.taken_bytes = 0  # so many have come to it, whatever became of them
        self._done = threading.Event()
        self._tool: socket.socket | None = None
        self._vehicle: socket.socket | None = None
        self._retry_at_s = 0.0
        self._up, self._down = Queue(delay_s), Queue(delay_s)
        self._cutters = {
            way: PacketCutter(ByteLoss(), random.Random(way)) for way in ("up", "down")
        }
        self._thread = threading.Thread(target=self._run, daemon=True, name="link")
        self._thread.start()

    @property
    def where(self) -> str:
        """The connection string for a tool."""
        return f"tcp:{LOOPBACK}:{self.port}"

    def lose(self, share: float) -> None:
        """From now on this share of its packets, both ways; 0: none."""
        for cutter in self._cutters.values():
            cutter.loss = ByteLoss(byte_loss=share)

    def _run(self) -> None:
        while not self._done.is_set():
            self._connect(time.monotonic())
            ends = [end for end in (self._listener, self._tool, self._vehicle) if end]
            for end in select.select(ends, [], [], self._pause_s())[0]:
                if end is self._listener:
                    self._accept()
                elif end is self._tool:
                    self._tool = self._read(end, self._up)
                elif end is self._vehicle:
                    self._vehicle = self._read(end, self._down)
            self._deliver(time.monotonic())

    def _pause_s(self) -> float:
        dues = [due for due in (self._up.due_s(), self._down.due_s()) if due is not None]
        return max(0.0, min([LONGEST_SLEEP_S, *(due - time.monotonic() for due in dues)]))

    def _connect(self, now_s: float) -> None:
        """To the vehicle, once a tool is there; again after the vehicle has restarted."""
        if self._tool is None or self._vehicle is not None or now_s < self._retry_at_s:
            return
        self._retry_at_s = now_s + RETRY_S
        with contextlib.suppress(OSError):
            self._vehicle = socket.create_connection((LOOPBACK, self._vehicle_port), timeout=1.0)
            _prepare(self._vehicle)

    def _accept(self) -> None:
        """A tool that comes anew takes the place of the one before."""
        self._hang_up()
        self._tool, _ = self._listener.accept()
        _prepare(self._tool)

    def _read(self, end: socket.socket, queue: Queue) -> socket.socket | None:
        """Take what has come; None: the end has gone."""
        try:
            data = end.recv(CHUNK_BYTES)
        except BlockingIOError:
            return end
        except OSError:
            data = b""
        if not data:
            end.close()
            if queue is self._up:
                self._hang_up()
            return None
        if not self.cut.is_set():
            queue.put(
                time.monotonic(), self._cutters["up" if queue is self._up else "down"].carry(data)
            )
        self.taken_bytes += len(data)
        return end

    def _deliver(self, now_s: float) -> None:
        if self.cut.is_set():
            self._up.clear()
            self._down.clear()
            return
        for queue, end in ((self._up, self._vehicle), (self._down, self._tool)):
            data = queue.take(now_s)
            if data and end is not None:
                with contextlib.suppress(OSError):
                    end.sendall(data)

    def _hang_up(self) -> None:
        for end in (self._tool, self._vehicle):
            if end is not None:
                end.close()
        self._tool = self._vehicle = None

    def close(self) -> None:
        """Take it away."""
        self._done.set()
        self._thread.join()
        self._hang_up()
        self._listener.close()


def _prepare(end: socket.socket) -> None:
    end.setblocking(False)
    end.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
