import contextlib
import os
import pty
import random
import socket
import threading
import time
import tty
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from echowing.errors import EchowingError
from echowing.mavlink.connection import DEFAULT_BAUD
from echowing.mavlink.links import (
    MOST_PEERS,
    MOST_READS,
    MOVED_S,
    REFUSED_S,
    RETRY_S,
    Address,
    Link,
    UdpListener,
    parse_address,
    wait,
)
from echowing.mavlink.seats import parse_seat
from echowing.mavlink.signing import LinkSigning
from echowing.stopping import StopRequest
from echowing.tool.leader import LeaderTool

DEADLINE_S = 60.0


def frame(system_id: int = 1, mode: int = 4) -> bytes:
    sender = mavlink.MAVLink(None, srcSystem=system_id, srcComponent=1)
    return bytes(mavlink.MAVLink_heartbeat_message(2, 3, 0, mode, 4, 3).pack(sender))


def until(done: Callable[[], Any]) -> Any:
    """Poll until something true comes, with a generous deadline."""
    until_s = time.monotonic() + DEADLINE_S
    while time.monotonic() < until_s:
        result = done()
        if result:
            return result
        time.sleep(0.005)
    pytest.fail("it never came")


def received(link: Link) -> list[Any]:
    """The messages that come next, whatever their number."""
    return list(until(lambda: link.receive(time.monotonic())))


def opened(text: str) -> Link:
    link = Link(parse_address(text))
    link.open()
    return link


def free_port(kind: socket.SocketKind) -> int:
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@pytest.fixture
def sender() -> Iterator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as vehicle:
        vehicle.bind(("127.0.0.1", 0))
        vehicle.settimeout(DEADLINE_S)
        yield vehicle


@pytest.mark.parametrize(
    ("text", "address"),
    [
        ("udpin:14550", ("udpin", "0.0.0.0", 14550)),
        ("udp:14550", ("udpin", "0.0.0.0", 14550)),
        ("udpin:127.0.0.1:14550", ("udpin", "127.0.0.1", 14550)),
        ("udpout:10.0.0.7:14550", ("udpout", "10.0.0.7", 14550)),
        ("tcp:localhost:5760", ("tcp", "localhost", 5760)),
        ("tcpin:5760", ("tcpin", "127.0.0.1", 5760)),
    ],
)
def test_connection_strings_hear_vehicles_on_wifi_and_streams_only_here(
    text: str, address: tuple[str, str, int]
) -> None:
    assert parse_address(text) == Address(text, *address)


def test_serial_devices_have_a_baud_rate() -> None:
    assert parse_address("/dev/ttyUSB0").baud == DEFAULT_BAUD
    assert parse_address("/dev/ttyUSB0", 115_200).baud == 115_200
    assert parse_address("/dev/ttyUSB0,921600", 115_200).baud == 921_600
    assert parse_address("COM5").host == "COM5"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("udpin:", "the port is a number"),
        ("udpin:70000", "the port is a number"),
        ("udpout:14550", "which host"),
        ("bluetooth:7", "no such kind"),
        ("/dev/ttyUSB0,fast", "baud rate"),
    ],
)
def test_other_connection_strings_are_refused(text: str, said: str) -> None:
    with pytest.raises(EchowingError, match=said):
        parse_address(text)


def test_datagrams_are_heard_and_answered(sender: socket.socket) -> None:
    port = free_port(socket.SOCK_DGRAM)
    link = opened(f"udpin:127.0.0.1:{port}")
    sender.sendto(frame(system_id=7), ("127.0.0.1", port))
    (message,) = received(link)
    assert message.get_srcSystem() == 7
    assert link.news == [f"link udpin:127.0.0.1:{port}: MAVLink received"]

    link.send(frame(system_id=245), 0.0)
    assert sender.recv(100) == frame(system_id=245)
    link.close()


def test_half_a_frame_does_not_swallow_the_next_datagram(sender: socket.socket) -> None:
    port = free_port(socket.SOCK_DGRAM)
    link = opened(f"udpin:127.0.0.1:{port}")
    # It promises 255 bytes: without care the next dozen heartbeats would be taken for them.
    sender.sendto(b"\xfd\xff\x00\x00", ("127.0.0.1", port))
    sender.sendto(frame(system_id=9), ("127.0.0.1", port))
    (message,) = received(link)
    assert message.get_srcSystem() == 9
    link.close()


def test_noise_yields_no_message_and_no_answer(sender: socket.socket) -> None:
    port = free_port(socket.SOCK_DGRAM)
    link = opened(f"udpin:127.0.0.1:{port}")
    chance = random.Random(3)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        stranger.bind(("127.0.0.1", 0))
        stranger.setblocking(False)
        for length in range(200):
            stranger.sendto(chance.randbytes(length), ("127.0.0.1", port))
            assert link.receive(0.0) == []
        sender.sendto(frame(), ("127.0.0.1", port))
        received(link)
        link.send(frame(), 0.0)
        assert sender.recv(100) == frame()
        with pytest.raises(BlockingIOError):
            stranger.recv(100)
    link.close()


def test_a_flood_leaves_the_caller_its_turn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Datagrams that come faster than they can be read: there is always one more."""
    link = opened(f"udpin:127.0.0.1:{free_port(socket.SOCK_DGRAM)}")
    monkeypatch.setattr(UdpListener, "read", lambda self: frame())
    assert len(link.receive(0.0)) == MOST_READS
    link.close()


def test_only_so_many_senders_are_answered(sender: socket.socket) -> None:
    port = free_port(socket.SOCK_DGRAM)
    link = opened(f"udpin:127.0.0.1:{port}")
    sender.sendto(frame(), ("127.0.0.1", port))
    received(link)
    # All open at a time: a port that is free again may be the next one's too.
    others = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(MOST_PEERS)]
    for other in others:
        other.sendto(frame(), ("127.0.0.1", port))
        received(link)
    for other in others:
        other.close()
    link.send(frame(), 0.0)  # the first is forgotten, and the vanished ones are no error
    sender.setblocking(False)
    with pytest.raises(BlockingIOError):
        sender.recv(100)
    link.close()


def test_a_formation_without_a_router_shares_one_port() -> None:
    """Fifty vehicles and their leader, each from a port of its own; all hear what is sent."""
    port = free_port(socket.SOCK_DGRAM)
    link = opened(f"udpin:127.0.0.1:{port}")
    vehicles = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(51)]
    for system_id, vehicle in enumerate(vehicles, 1):
        vehicle.settimeout(DEADLINE_S)
        vehicle.sendto(frame(system_id), ("127.0.0.1", port))
        received(link)
    link.send(frame(245), 0.0)
    for vehicle in vehicles:
        assert vehicle.recv(100) == frame(245)
        vehicle.close()
    link.close()


def test_who_has_not_been_heard_for_longest_is_forgotten_first(sender: socket.socket) -> None:
    port = free_port(socket.SOCK_DGRAM)
    link = opened(f"udpin:127.0.0.1:{port}")
    for _ in range(MOST_PEERS):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as passer_by:
            for one in (sender, passer_by):
                one.sendto(frame(), ("127.0.0.1", port))
                received(link)
    link.send(frame(245), 0.0)
    assert sender.recv(100) == frame(245)
    link.close()


def test_once_its_vehicles_are_found_nobody_else_is_heard_or_answered(
    sender: socket.socket,
) -> None:
    """Any sender became a peer, and received the points."""
    port = free_port(socket.SOCK_DGRAM)
    link = opened(f"udpin:127.0.0.1:{port}")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 0))
        other.setblocking(False)
        for one, system_id in ((sender, 1), (other, 7)):
            one.sendto(frame(system_id), ("127.0.0.1", port))
            received(link)
        link.keep([1])
        link.news.clear()
        for system_id in (1, 7):  # with the vehicle's id too
            other.sendto(frame(system_id), ("127.0.0.1", port))
            until(lambda: not link.receive(1.0) and link.news)
        where = f"127.0.0.1:{other.getsockname()[1]}"
        assert link.news == [
            f"link {link.name}: {where} sends to it too, and is neither heard nor answered"
        ]
        link.send(frame(245), 1.0)
        assert sender.recv(100) == frame(245)
        with pytest.raises(BlockingIOError):
            other.recv(100)
        sender.sendto(frame(1), ("127.0.0.1", port))
        assert received(link)[0].get_srcSystem() == 1
    link.close()


def test_each_vehicle_that_shares_the_port_keeps_its_own_sender(sender: socket.socket) -> None:
    """Vehicles without a router: as many peers as were named on the command line, no more."""
    port = free_port(socket.SOCK_DGRAM)
    link = opened(f"udpin:127.0.0.1:{port}")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.settimeout(DEADLINE_S)
        for one, system_id in ((sender, 1), (other, 2), (other, 1)):
            one.sendto(frame(system_id), ("127.0.0.1", port))
            received(link)
        link.keep([1, 2])
        link.send(frame(245), 0.0)
        assert (sender.recv(100), other.recv(100)) == (frame(245), frame(245))
        link.keep([1])  # its first sender, though another has said to be it
        link.send(frame(246), 0.0)
        assert sender.recv(100) == frame(246)
        other.setblocking(False)
        with pytest.raises(BlockingIOError):
            other.recv(100)
    link.close()


def test_a_peer_that_fell_silent_may_go_on_from_another_port(sender: socket.socket) -> None:
    """A bridge that was restarted has a port of its own again, on the same computer."""
    port = free_port(socket.SOCK_DGRAM)
    link = opened(f"udpin:127.0.0.1:{port}")
    sender.sendto(frame(1), ("127.0.0.1", port))
    until(lambda: link.receive(10.0))
    link.keep([1])
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as again:
        again.settimeout(DEADLINE_S)
        for system_id in (1, 7):
            again.sendto(frame(system_id), ("127.0.0.1", port))
            wait([link], DEADLINE_S)
            assert link.receive(10.0 + MOVED_S if system_id == 1 else 11.0 + MOVED_S) == []
        again.sendto(frame(1), ("127.0.0.1", port))
        assert len(until(lambda: link.receive(11.0 + MOVED_S))) == 1
        link.send(frame(245), 0.0)
        assert again.recv(100) == frame(245)
        sender.setblocking(False)
        with pytest.raises(BlockingIOError):
            sender.recv(100)
    link.close()


def test_udpout_hears_only_whom_it_speaks_to(sender: socket.socket) -> None:
    link = opened(f"udpout:127.0.0.1:{sender.getsockname()[1]}")
    link.send(frame(245), 0.0)
    _, back = sender.recvfrom(100)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.sendto(frame(7), back)
    sender.sendto(frame(3), back)
    assert [one.get_srcSystem() for one in received(link)] == [3]
    link.close()


def test_two_leaders_that_publish_to_each_other_do_not_circulate(
    sender: socket.socket, monkeypatch: pytest.MonkeyPatch
) -> None:
    """38,000 datagrams a second, for ever, of one heartbeat."""
    passed: list[bytes] = []
    pass_on = Link.send

    def counted(link: Link, data: bytes, now_s: float) -> None:
        passed.append(data)
        pass_on(link, data, now_s)

    monkeypatch.setattr(Link, "send", counted)
    ports = [free_port(socket.SOCK_DGRAM) for _ in range(2)]
    end = StopRequest()
    tools = [
        LeaderTool(
            parse_seat("leader", f"udpin:127.0.0.1:{here}@1"),
            parse_address(f"udpout:127.0.0.1:{there}"),
            4.0,
            end,
        )
        for here, there in (ports, ports[::-1])
    ]
    threads = [threading.Thread(target=tool.run, args=(None,)) for tool in tools]
    for thread in threads:
        thread.start()

    def sent_once_more() -> bool:
        sender.sendto(frame(1), ("127.0.0.1", ports[0]))
        sent.append(frame(1))
        return passed.count(frame(1)) > 40

    sent: list[bytes] = []
    until(sent_once_more)
    end.count += 1
    for thread in threads:
        thread.join()
    # Each is passed on by the one, and by the other to the first.
    assert passed.count(frame(1)) <= 2 * len(sent)


def test_udpout_speaks_first_and_hears_the_answer(sender: socket.socket) -> None:
    link = opened(f"udpout:127.0.0.1:{sender.getsockname()[1]}")
    link.send(frame(245), 0.0)
    data, back = sender.recvfrom(100)
    assert data == frame(245)
    sender.sendto(frame(3), back)
    (message,) = received(link)
    assert message.get_srcSystem() == 3
    link.close()


@pytest.mark.parametrize("kind", ["tcp", "udpout"])
def test_a_name_is_looked_up_once(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A lookup waits for seconds where the network has gone, and followers want points then."""
    asked: list[str] = []

    def look_up(host: str) -> str:
        asked.append(host)
        return "127.0.0.1"

    monkeypatch.setattr(socket, "gethostbyname", look_up)
    link = Link(parse_address(f"{kind}:{kind}.drone.test:{free_port(socket.SOCK_STREAM)}"))
    for step in range(4):
        link.receive(step * 2.0 * RETRY_S)
        link.close()
    assert asked == [f"{kind}.drone.test"]


def test_tcp_waits_for_a_listener_and_comes_back_to_the_next() -> None:
    port = free_port(socket.SOCK_STREAM)
    link = opened(f"tcp:127.0.0.1:{port}")
    now_s = 0.0
    until(lambda: not link.receive(now_s) and link.news)
    assert link.news == [
        f"link tcp:127.0.0.1:{port}: nothing listens there; trying again every 1 s"
    ]
    link.news.clear()
    for _ in range(2):
        now_s += RETRY_S
        with socket.create_server(("127.0.0.1", port)) as listener:
            link.receive(now_s)
            vehicle, _ = listener.accept()
            vehicle.sendall(frame(4)[:5])
            vehicle.sendall(frame(4)[5:])
            (message,) = until(lambda: link.receive(now_s))  # noqa: B023 (called at once)
            assert message.get_srcSystem() == 4
            link.send(frame(245), now_s)
            assert vehicle.recv(100) == frame(245)
            vehicle.close()
        until(lambda: not link.receive(now_s) and not link.connected)  # noqa: B023 (called at once)
    told = f"link tcp:127.0.0.1:{port}: "
    assert (
        link.news
        == [
            *(f"{told}MAVLink received", f"{told}closed by the other end; trying again every 1 s"),
        ]
        * 2
    )
    link.close()


def test_tcpin_takes_one_connection_after_the_other() -> None:
    port = free_port(socket.SOCK_STREAM)
    link = opened(f"tcpin:{port}")
    for system_id in (5, 6):
        with socket.create_connection(("127.0.0.1", port)) as vehicle:
            vehicle.settimeout(DEADLINE_S)
            vehicle.sendall(frame(system_id))
            (message,) = received(link)
            assert message.get_srcSystem() == system_id
            link.send(frame(245), 0.0)
            assert vehicle.recv(100) == frame(245)
    link.close()


def test_a_serial_device_is_a_link() -> None:
    master, slave = pty.openpty()
    tty.setraw(slave)
    link = opened(os.ttyname(slave))
    os.write(master, b"boot: noise" + frame(8))
    (message,) = received(link)
    assert message.get_srcSystem() == 8
    link.send(frame(245), 0.0)
    assert os.read(master, 100) == frame(245)
    link.close()
    os.close(master)
    os.close(slave)


def test_a_serial_device_that_takes_no_more_bytes_holds_nobody_up() -> None:
    """A radio that has stopped us by its flow control: the other vehicles still want points."""
    master, slave = pty.openpty()
    tty.setraw(master)
    tty.setraw(slave)
    link = opened(os.ttyname(slave))
    for _ in range(5_000):  # far more than a terminal keeps for a reader that does not read
        link.send(frame(245), 0.0)
    assert link.news == []
    os.set_blocking(master, False)
    with contextlib.suppress(BlockingIOError):
        while os.read(master, 65_536):
            pass
    link.send(frame(245), 0.0)
    assert os.read(master, 100).endswith(frame(245))  # after the end of one cut short, perhaps
    link.close()
    os.close(master)
    os.close(slave)


def test_a_serial_device_belongs_to_one_tool() -> None:
    master, slave = pty.openpty()
    link = opened(os.ttyname(slave))
    with pytest.raises(EchowingError, match="the device is busy; another tool has it open"):
        opened(os.ttyname(slave))
    link.close()
    os.close(master)
    os.close(slave)


def test_a_missing_device_and_a_taken_port_say_so(sender: socket.socket) -> None:
    with pytest.raises(EchowingError, match="no such device; is it plugged in"):
        opened("/dev/echowing-is-not-there")
    with pytest.raises(EchowingError, match="the port is taken"):
        opened(f"udpin:127.0.0.1:{sender.getsockname()[1]}")


def test_waiting_ends_when_something_comes(sender: socket.socket) -> None:
    port = free_port(socket.SOCK_DGRAM)
    links = [opened(f"udpin:127.0.0.1:{port}"), Link(parse_address("tcp:127.0.0.1:1"))]
    sender.sendto(frame(), ("127.0.0.1", port))
    wait(links, DEADLINE_S)
    assert len(links[0].receive(0.0)) == 1
    links[0].close()


# ---- signing ----------------------------------------------------------------------------------

KEY, OTHER_KEY = bytes(range(32)), bytes(32)


def signed_frame(key: bytes, unix_s: float) -> bytes:
    sender = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    signing = LinkSigning(key, 0, lambda: unix_s)
    signing.apply(sender)
    signing.keep_time()
    return bytes(mavlink.MAVLink_heartbeat_message(2, 3, 0, 4, 4, 3).pack(sender))


def test_a_link_with_a_key_believes_only_what_is_signed_and_says_so_once(
    sender: socket.socket,
) -> None:
    port = free_port(socket.SOCK_DGRAM)
    link = Link(parse_address(f"udpin:127.0.0.1:{port}"), LinkSigning(KEY, 1))
    link.open()
    for now_s in (0.0, REFUSED_S - 0.1, REFUSED_S, 2 * REFUSED_S):
        assert link.news == []
        sender.sendto(frame(), ("127.0.0.1", port))
        wait([link], DEADLINE_S)
        assert link.receive(now_s) == []
        if now_s == REFUSED_S:
            (told,) = link.news
            assert "not signed with the key" in told
            link.news.clear()
    assert link.news == []
    sender.sendto(signed_frame(KEY, time.time()), ("127.0.0.1", port))
    assert received(link)[0].get_signed()
    link.close()


def test_a_vehicle_with_an_old_clock_is_answered_so_that_it_learns_the_time(
    sender: socket.socket,
) -> None:
    port = free_port(socket.SOCK_DGRAM)
    link = Link(parse_address(f"udpin:127.0.0.1:{port}"), LinkSigning(KEY, 1))
    link.open()
    day_old = signed_frame(KEY, time.time() - 86_400)
    sender.sendto(day_old, ("127.0.0.1", port))
    wait([link], DEADLINE_S)
    assert link.receive(time.monotonic()) == []  # it might be a recording
    link.send(b"hello", time.monotonic())
    assert sender.recv(100) == b"hello"
    link.close()


@pytest.mark.parametrize(
    ("vehicle", "publish", "loops"),
    [
        ("udpin:14550", "udpout:127.0.0.1:14550", True),
        ("udpin:127.0.0.1:14550", "udpout:localhost:14550", True),
        ("udpin:127.0.0.1:14550", "udpout:127.0.0.1:14550", True),
        ("udpout:127.0.0.1:14550", "udpout:127.0.0.1:14550", True),
        ("udpin:14550", "udpout:127.0.0.1:14600", False),
        ("udpin:14550", "udpout:192.0.2.1:14550", False),  # of nobody (RFC 5737)
        ("tcp:127.0.0.1:14550", "udpout:127.0.0.1:14550", False),
    ],
)
def test_a_leader_is_not_published_to_where_it_is_heard(
    vehicle: str, publish: str, loops: bool
) -> None:
    make = partial(
        LeaderTool, parse_seat("leader", vehicle), parse_address(publish), 4.0, StopRequest()
    )
    if loops:
        with pytest.raises(EchowingError, match="circulate for ever; give another port"):
            make()
    else:
        make()


def test_of_a_published_leader_all_is_asked_for_that_follow_shows(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    seat = parse_seat("leader", "udpin:14550@1")
    tool = LeaderTool(seat, parse_address("udpout:127.0.0.1:14600"), 4.0, StopRequest())
    sent: list[bytes] = []
    monkeypatch.setattr(tool._vehicle.link, "send", lambda frame, _: sent.append(frame))
    tool._begin()
    tool._ask(0.0)
    heard = [mavlink.MAVLink(None).decode(bytearray(frame)) for frame in sent]
    asked = {
        mavlink.mavlink_map[round(one.param1)].msgname
        for one in heard
        if one.get_type() == "COMMAND_LONG"
    }
    flown = {"GLOBAL_POSITION_INT", "RC_CHANNELS", "EKF_STATUS_REPORT"}
    assert asked == flown | {"GPS_RAW_INT", "SYS_STATUS"}
