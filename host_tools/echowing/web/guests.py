"""Who may open the page: requests that another web site has caused are refused. Pure.

A web site can make its own name resolve to this computer's address (DNS rebinding) and then read
what is served here. Its requests carry its name as Host, and its own Origin. So the Host must be an
address or a name of this computer, and the Origin, if there is one, must be the page's own.
"""

import ipaddress
import re
import socket

from echowing.web.options import is_loopback

# A name, an IPv4 address, or an IPv6 address in brackets; and a port.
_HOST = re.compile(r"(\[(?P<address>[0-9a-f:.]+)\]|(?P<name>[a-z0-9._-]+))(:\d{1,5})?")


def refusal(served_on: str, host: str | None, origin: str | None) -> str | None:
    """Why a request with these headers is refused; None: it is accepted.

    served_on: the address on which the server listens.
    """
    name = _name(host)
    if name is None or not _is_ours(served_on, name):
        return f"Host {host!r} is not a name of this computer; open the page by its address"
    if origin is not None and origin.lower() != f"http://{host}".lower():
        return f"Origin {origin!r} is another site"
    return None


def _name(host: str | None) -> str | None:
    """The name or address in a Host header. Our headers contain it, so it may hold nothing else."""
    found = _HOST.fullmatch((host or "").lower())
    return None if found is None else found["address"] or found["name"]


def _is_ours(served_on: str, name: str) -> bool:
    """An address cannot be redirected to another computer; a name can."""
    if is_loopback(served_on):
        return is_loopback(name)
    own = socket.gethostname().lower()
    if name in ("localhost", own, f"{own}.local"):
        return True
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True
