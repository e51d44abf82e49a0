"""Two browsers for `echowing bench`: one reads the page's stream, one reads nothing.

`python -m echowing.bench.watcher PORT` watches until its standard input ends, and then prints how
many frames a second have come.
"""

import asyncio
import socket
import sys
import time

from aiohttp import ClientSession

HERE = "127.0.0.1"
UPGRADE = (
    "GET /live HTTP/1.1\r\nHost: {host}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    "Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n"
)


def dead_browser(port: int) -> socket.socket:
    """A WebSocket that is open and never read; its buffer is as small as can be."""
    line = socket.socket()
    line.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    line.connect((HERE, port))
    line.sendall(UPGRADE.format(host=f"{HERE}:{port}").encode())
    return line


async def watch(port: int) -> float:
    """Read until standard input ends; frames a second, from the first to the last."""
    times_s: list[float] = []
    ended = asyncio.get_running_loop().run_in_executor(None, sys.stdin.read)
    async with (
        ClientSession() as session,
        session.ws_connect(f"ws://{HERE}:{port}/live") as browser,
    ):

        async def read() -> None:
            async for message in browser:
                if message.data.startswith('{"kind":"frame"'):
                    times_s.append(time.monotonic())

        reading = asyncio.ensure_future(read())
        await ended
        reading.cancel()
    if len(times_s) < 2:
        return 0.0
    return (len(times_s) - 1) / (times_s[-1] - times_s[0])


def main() -> None:
    """The process: PORT."""
    port = int(sys.argv[1])
    with dead_browser(port):
        print(asyncio.run(watch(port)))


if __name__ == "__main__":
    main()
