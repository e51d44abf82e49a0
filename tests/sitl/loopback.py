"""A network of the suite's own, with loopback only.

ArduCopter listens on every address that the system has. Its own network namespace has only
loopback, so nothing that the suite starts can be reached from outside, and no port is taken.
"""

import ctypes
import fcntl
import os
import socket
import struct
from pathlib import Path

# <sched.h>, <linux/sockios.h>, <net/if.h>
CLONE_NEWUSER, CLONE_NEWNET = 0x1000_0000, 0x4000_0000
GET_FLAGS, SET_FLAGS = 0x8913, 0x8914
INTERFACE_UP = 1
LOOPBACK = "lo"
_REQUEST = struct.Struct("16sH14x")  # struct ifreq: the name, then its flags


class NotOnLoopbackError(Exception):
    """Something could be reached from outside this machine; says what to do."""


def enter() -> None:
    """Move this process, and all that it will start, to a network with loopback only.

    Call it before any thread is started. Raises NotOnLoopbackError where the system refuses.
    """
    uid, gid = os.getuid(), os.getgid()
    own_user = 0 if uid == 0 else CLONE_NEWUSER
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.unshare(CLONE_NEWNET | own_user) != 0:
        raise NotOnLoopbackError(
            f"no network of its own for the suite: {os.strerror(ctypes.get_errno())}. ArduCopter "
            "listens on all addresses, so it runs only in a network with loopback alone. Run as "
            "root, or let users make namespaces (sysctl kernel.unprivileged_userns_clone=1; on "
            "Ubuntu also kernel.apparmor_restrict_unprivileged_userns=0)"
        )
    if own_user:
        Path("/proc/self/setgroups").write_text("deny")
        Path("/proc/self/uid_map").write_text(f"{uid} {uid} 1")
        Path("/proc/self/gid_map").write_text(f"{gid} {gid} 1")
    _set_up(LOOPBACK)


def _set_up(name: str) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
        flags = _flags(any_socket, name) | INTERFACE_UP
        fcntl.ioctl(any_socket, SET_FLAGS, _REQUEST.pack(name.encode(), flags))


def _flags(any_socket: socket.socket, name: str) -> int:
    answer = fcntl.ioctl(any_socket, GET_FLAGS, _REQUEST.pack(name.encode(), 0))
    return int(_REQUEST.unpack(answer)[1])


def reachable_interfaces() -> list[str]:
    """Interfaces of this process's network that are up, loopback left out."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
        return [
            name
            for _, name in socket.if_nameindex()
            if name != LOOPBACK and _flags(any_socket, name) & INTERFACE_UP
        ]


def require(pid: int) -> list[str]:
    """See that a process can be reached over loopback only; returns where it listens.

    Raises NotOnLoopbackError otherwise: the caller has to end the process then.
    """
    addresses = listening(pid)
    same_network = _network_of(pid) == _network_of(os.getpid())
    reachable = reachable_interfaces()
    if same_network and not reachable:
        return addresses
    outside = [address for address in addresses if not address.startswith("127.")]
    if outside:
        raise NotOnLoopbackError(
            f"process {pid} listens on {', '.join(outside)} in a network with "
            f"{', '.join(reachable) or 'other interfaces'}; start the suite by `make test-sitl`"
        )
    return addresses


def _network_of(pid: int) -> str:
    return str(Path(f"/proc/{pid}/ns/net").readlink())


def listening(pid: int) -> list[str]:
    """The addresses, HOST:PORT, of a process's listening TCP and open UDP sockets."""
    inodes = {
        text.removeprefix("socket:[").removesuffix("]")
        for text in map(_target, Path(f"/proc/{pid}/fd").iterdir())
        if text.startswith("socket:[")
    }
    found: list[str] = []
    for kind, listens in (("tcp", "0A"), ("udp", "07"), ("tcp6", "0A"), ("udp6", "07")):
        table = Path(f"/proc/{pid}/net/{kind}")
        lines = table.read_text().splitlines()[1:] if table.exists() else []
        for fields in map(str.split, lines):
            if fields[9] in inodes and fields[3] == listens:
                found.append(address_from(fields[1]))
    return sorted(found)


def _target(link: Path) -> str:
    try:
        return str(link.readlink())
    except FileNotFoundError:  # closed meanwhile
        return ""


def address_from(text: str) -> str:
    """HOST:PORT from a local address as the kernel's tables have it, `0100007F:1680`."""
    host, _, port = text.partition(":")
    words = [bytes.fromhex(host[start : start + 8])[::-1] for start in range(0, len(host), 8)]
    family = socket.AF_INET if len(words) == 1 else socket.AF_INET6
    return f"{socket.inet_ntop(family, b''.join(words))}:{int(port, 16)}"
