"""Where the page is served: the options `--web [PORT]` and `--web-address` of several verbs."""

import argparse
import ipaddress
from dataclasses import dataclass

from echowing.errors import EchowingError

DEFAULT_PORT = 8017  # not assigned in IANA's list
LOOPBACK = "127.0.0.1"


@dataclass(frozen=True, slots=True)
class PageAddress:
    """Where to listen."""

    host: str = LOOPBACK
    port: int = DEFAULT_PORT

    @property
    def url(self) -> str:
        """The URL for a browser on this computer."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"http://{host}:{self.port}/"

    @property
    def is_loopback(self) -> bool:
        """Whether only this computer can reach it."""
        return is_loopback(self.host)

    @property
    def said(self) -> str:
        """What the operator reads."""
        if self.is_loopback:
            return f"page: {self.url}"
        return f"page: {self.url}, everybody on the network can open it; it commands nothing"


def is_loopback(host: str) -> bool:
    """Whether a host name or address is this computer's own."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host.lower() == "localhost"


def add_web_arguments(parser: argparse.ArgumentParser, *, always: bool = False) -> None:
    """`--web` and `--web-address`; always: the verb always serves the page."""
    group = parser.add_argument_group("page")
    group.add_argument(
        "--web",
        type=int,
        nargs="?",
        const=DEFAULT_PORT,
        default=DEFAULT_PORT if always else None,
        metavar="PORT",
        help=f"show the flight in a browser, on http://{LOOPBACK}:PORT/ ({DEFAULT_PORT})",
    )
    group.add_argument(
        "--web-address",
        metavar="ADDRESS",
        help=f"listen on this address of the computer instead of {LOOPBACK}, so that a phone "
        "can open the page (0.0.0.0: on all). Everybody on that network can see it",
    )


def page_address(args: argparse.Namespace) -> PageAddress | None:
    """Where to serve the page; None: nowhere. Raises EchowingError for invalid options."""
    if args.web is None:
        if args.web_address is not None:
            raise EchowingError("--web-address needs --web")
        return None
    if not 0 <= args.web <= 65_535:
        raise EchowingError(f"--web {args.web}: give a port from 1 to 65535, or 0 for a free one")
    host = args.web_address or LOOPBACK
    try:
        host = "127.0.0.1" if host == "localhost" else str(ipaddress.ip_address(host))
    except ValueError:
        raise EchowingError(
            f"--web-address {host}: give an address of this computer, for example "
            "192.168.1.10, or 0.0.0.0"
        ) from None
    return PageAddress(host, args.web)
