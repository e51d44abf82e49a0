"""MAVLink's file transfer: the client against the simulated autopilot's server, over bad wires."""

import errno
import random
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from echowing.errors import EchowingError
from echowing.setup import applet, ftp
from echowing.setup.applet import applet_path, install_over_link
from echowing.setup.ftp import Entry, FtpClient, FtpRefusedError, NoAnswerError
from echowing.setup.ftp_format import DATA_BYTES, Fault, Op, Packet, ardupilot_crc32
from echowing.sim.vehicle.ftp import SESSION_KILL_S, FtpServer

SENDER = ("telemetry", 245, 190)
OTHER = ("telemetry", 255, 190)
SCRIPTS = "APM/scripts"
TARGET = f"{SCRIPTS}/echowing.lua"


class Wire:
    """A wire to a server, with a clock of its own; `lose` tells which packets are lost."""

    def __init__(self, server: FtpServer, lose: Callable[[], bool] = lambda: False) -> None:
        self.server = server
        self.lose = lose
        self.requests: list[Packet] = []
        self._t_s = 0.0
        self._coming: list[bytes] = []

    def now_s(self) -> float:
        return self._t_s

    def send_file_request(self, payload: bytes) -> None:
        self.requests.append(Packet.unpacked(payload))
        if self.lose():
            return
        answers = self.server.answer(SENDER, payload.rstrip(b"\0"), self._t_s)
        self._coming += [answer for answer in answers if not self.lose()]

    def file_answers(self, timeout_s: float) -> list[bytes]:
        self._t_s += 0.01 if self._coming else timeout_s
        coming, self._coming = self._coming, []
        return coming


@pytest.fixture
def card(tmp_path: Path) -> Path:
    (tmp_path / "APM").mkdir()
    return tmp_path


def quiet(done: int, total: int) -> None:
    assert 0 <= done <= total


def no_bar(title: str) -> ftp.Progress:
    return quiet


def ask(
    server: FtpServer,
    operation: int,
    data: bytes = b"",
    *,
    sequence: int = 1,
    session: int = 7,
    offset: int = 0,
    size: int | None = None,
    t_s: float = 0.0,
    sender: tuple[str, int, int] = SENDER,
) -> list[Packet]:
    packet = Packet(sequence, session, operation, data, offset, size)
    return [Packet.unpacked(one) for one in server.answer(sender, packet.packed(), t_s)]


def fault_of(packets: list[Packet]) -> int:
    assert packets[0].operation == Op.NACK
    return packets[0].data[0]


# ---- the format -------------------------------------------------------------------------------


def test_checksum_is_ardupilots_not_zlibs() -> None:
    # Bit by bit as AP_Math/crc.cpp, crc32_small, begun at 0; zlib would give cbf43926.
    assert ardupilot_crc32(b"123456789") == 0x2DFD2D88
    assert ardupilot_crc32(b"") == 0


def test_a_packet_survives_the_wire_without_its_zeros_at_the_end() -> None:
    packet = Packet(0xFFFF, 9, Op.WRITE_FILE, b"ab\0", 70_000)
    back = Packet.unpacked(packet.packed().rstrip(b"\0"))
    assert (back.sequence, back.session, back.operation) == (0xFFFF, 9, Op.WRITE_FILE)
    assert (back.data, back.offset) == (b"ab\0", 70_000)
    assert len(packet.packed()) == 251


# ---- the server, as ArduPilot answers ---------------------------------------------------------


def test_an_answer_bears_the_next_number_and_what_was_asked(card: Path) -> None:
    (reply,) = ask(FtpServer(card), Op.CREATE_FILE, b"APM/a", sequence=0xFFFF)
    assert (reply.sequence, reply.session, reply.answered) == (0, 7, Op.CREATE_FILE)
    assert reply.operation == Op.ACK


def test_a_request_told_twice_is_answered_twice_and_done_once(card: Path) -> None:
    server = FtpServer(card)
    ask(server, Op.CREATE_FILE, b"APM/a")
    (again,) = ask(server, Op.CREATE_FILE, b"APM/a")
    assert again.operation == Op.ACK  # done twice it would be refused: a file is open
    assert fault_of(ask(server, Op.CREATE_FILE, b"APM/a", sequence=2)) == Fault.FAIL


def test_refusals_name_their_reason(card: Path) -> None:
    server = FtpServer(card)
    (card / "APM" / "there").write_text("x")
    (card / "APM" / "too").write_text("y")
    assert fault_of(ask(server, Op.OPEN_FILE_RO, b"APM/no", sequence=1)) == Fault.FILE_NOT_FOUND
    assert fault_of(ask(server, Op.CREATE_DIRECTORY, b"APM", sequence=3)) == Fault.FILE_EXISTS
    assert fault_of(ask(server, Op.RENAME, b"APM/too\0APM/there", sequence=5)) == Fault.FILE_EXISTS
    assert fault_of(ask(server, Op.TRUNCATE_FILE, b"APM", sequence=7)) == Fault.UNKNOWN_COMMAND
    assert fault_of(ask(server, Op.WRITE_FILE, b"x", sequence=9)) == Fault.FILE_NOT_FOUND
    assert fault_of(ask(server, Op.LIST_DIRECTORY, b"", sequence=11)) == Fault.INVALID_DATA_SIZE
    assert fault_of(ask(server, Op.OPEN_FILE_RO, b"../x", sequence=13)) == Fault.FAIL_ERRNO
    assert (card / "APM" / "there").read_text() == "x"


def test_five_sessions_and_a_sixth_only_when_one_has_been_silent(card: Path) -> None:
    server = FtpServer(card)
    for number in range(1, 6):
        ask(server, Op.CREATE_FILE, f"APM/{number}".encode(), session=number, sequence=2 * number)
    refused = ask(server, Op.NONE, session=6, sequence=20, t_s=2.9)
    assert fault_of(refused) == Fault.NO_SESSIONS_AVAILABLE
    (taken,) = ask(server, Op.NONE, session=6, sequence=22, t_s=3.1)
    assert taken.operation == Op.ACK


def test_session_0_is_given_a_number(card: Path) -> None:
    server = FtpServer(card)
    (reply,) = ask(server, Op.CREATE_FILE, b"APM/a", session=0)
    assert reply.session != 0
    (written,) = ask(server, Op.WRITE_FILE, b"x", session=reply.session, sequence=5)
    assert written.operation == Op.ACK


def test_a_session_forgotten_is_closed_in_the_end(card: Path) -> None:
    server = FtpServer(card)
    ask(server, Op.CREATE_FILE, b"APM/a")
    late_s = SESSION_KILL_S + 0.1
    assert fault_of(ask(server, Op.WRITE_FILE, b"x", sequence=5, t_s=late_s)) == (
        Fault.FILE_NOT_FOUND
    )


def test_sessions_of_others_are_not_reset(card: Path) -> None:
    server = FtpServer(card)
    ask(server, Op.CREATE_FILE, b"APM/a")
    ask(server, Op.RESET_SESSIONS, sender=OTHER, sequence=3)
    (still,) = ask(server, Op.WRITE_FILE, b"x", sequence=5)
    assert still.operation == Op.ACK
    ask(server, Op.RESET_SESSIONS, sequence=7)
    assert fault_of(ask(server, Op.WRITE_FILE, b"x", sequence=9)) == Fault.FILE_NOT_FOUND


def test_a_burst_sends_the_whole_file_and_says_where_it_ends(card: Path) -> None:
    server = FtpServer(card)
    content = bytes(range(256)) * 3
    (card / "APM" / "a").write_bytes(content)
    ask(server, Op.OPEN_FILE_RO, b"APM/a")
    packets = ask(server, Op.BURST_READ_FILE, size=DATA_BYTES, sequence=10)
    assert b"".join(one.data for one in packets[:-1]) == content
    assert [one.sequence for one in packets] == list(range(11, 11 + len(packets)))
    assert packets[-1].data[0] == Fault.END_OF_FILE
    assert [one.burst_complete for one in packets] == [False] * (len(packets) - 1) + [True]


def test_a_full_card_is_an_input_output_error_as_on_fat(card: Path) -> None:
    server = FtpServer(card, capacity_bytes=10)
    ask(server, Op.CREATE_FILE, b"APM/a")
    assert ask(server, Op.WRITE_FILE, b"0123456789", sequence=3)[0].operation == Op.ACK
    (full,) = ask(server, Op.WRITE_FILE, b"x", offset=10, sequence=5)
    assert full.data == bytes([Fault.FAIL_ERRNO, errno.EIO])


# ---- the client -------------------------------------------------------------------------------


def test_a_folder_of_many_files_is_listed_in_pieces(card: Path) -> None:
    names = [f"file-number-{i:02}.txt" for i in range(40)]
    for name in names:
        (card / "APM" / name).write_text("12345")
    (card / "APM" / "scripts").mkdir()
    listed = FtpClient(Wire(FtpServer(card))).entries("APM")
    assert [one.name for one in listed] == [*names, "scripts"]
    assert listed[0] == Entry(names[0], is_folder=False, size_bytes=5)
    assert listed[-1] == Entry("scripts", is_folder=True)


@pytest.mark.parametrize("seed", range(5))
def test_a_third_of_all_packets_lost_and_the_file_is_the_same(card: Path, seed: int) -> None:
    chance = random.Random(seed)
    content = chance.randbytes(7_777)
    client = FtpClient(Wire(FtpServer(card), lambda: chance.random() < 0.33))
    client.upload("APM/a", content, quiet)
    assert (card / "APM" / "a").read_bytes() == content
    assert client.download("APM/a", quiet) == content
    assert client.checksum("APM/a") == ardupilot_crc32(content)


def test_only_what_was_lost_is_sent_again(card: Path) -> None:
    wire = Wire(FtpServer(card))
    lost = iter([False, True])  # the answer to the first write
    wire.lose = lambda: len(wire.requests) == 2 and next(lost, False)
    FtpClient(wire).upload("APM/a", bytes(2_000), quiet)
    written = [one.offset for one in wire.requests if one.operation == Op.WRITE_FILE]
    assert sorted(written) == sorted([0, *range(0, 2_000, ftp.BLOCK_BYTES)])


def test_a_session_lost_in_the_middle_is_opened_again_without_starting_over(card: Path) -> None:
    wire = Wire(FtpServer(card))

    def restart_once() -> bool:
        if len(wire.requests) == 12:
            wire.server = FtpServer(card)  # the autopilot has forgotten everything
        return False

    wire.lose = restart_once
    content = random.Random(1).randbytes(5_000)
    FtpClient(wire).upload("APM/a", content, quiet)
    assert (card / "APM" / "a").read_bytes() == content
    opened = [one.operation for one in wire.requests if one.operation != Op.WRITE_FILE]
    assert opened == [Op.CREATE_FILE, Op.OPEN_FILE_WO, Op.TERMINATE_SESSION]


def test_without_answers_it_says_so_after_a_while(card: Path) -> None:
    wire = Wire(FtpServer(card), lambda: True)
    with pytest.raises(NoAnswerError, match="has no MAVFTP"):
        FtpClient(wire).reset()
    assert ftp.GIVE_UP_S <= wire.now_s() < 2 * ftp.GIVE_UP_S


def test_a_wire_cut_in_the_middle_ends_it(card: Path) -> None:
    wire = Wire(FtpServer(card))
    wire.lose = lambda: len(wire.requests) > 6
    with pytest.raises(NoAnswerError, match="stopped answering in the middle"):
        FtpClient(wire).upload("APM/a", bytes(5_000), quiet)


class ShortServer(FtpServer):
    """Gives 48 bytes at most, as ArduPilot on an RP2350."""

    def _read(self, session, request):  # type: ignore[no-untyped-def]
        return super()._read(session, replace(request, size=min(request.size, 48)))


def test_a_board_that_gives_less_than_it_is_asked_for_is_read_whole(card: Path) -> None:
    content = random.Random(3).randbytes(2_345)
    (card / "APM" / "a").write_bytes(content)
    assert FtpClient(Wire(ShortServer(card))).download("APM/a", quiet) == content


class EmptyServer(FtpServer):
    """Acknowledges a read and gives nothing."""

    def _read(self, session, request):  # type: ignore[no-untyped-def]
        return replace(super()._read(session, request), data=b"", size=0)


def test_a_board_that_gives_nothing_is_told(card: Path) -> None:
    (card / "APM" / "a").write_bytes(b"content")
    with pytest.raises(EchowingError, match="empty pieces"):
        FtpClient(Wire(EmptyServer(card))).download("APM/a", quiet)


def test_an_empty_file_comes_and_goes(card: Path) -> None:
    client = FtpClient(Wire(FtpServer(card)))
    client.upload("APM/a", b"", quiet)
    assert client.download("APM/a", quiet) == b""


def test_waits_for_a_session_that_others_hold(card: Path) -> None:
    server = FtpServer(card)
    for number in range(1, 6):
        ask(server, Op.CREATE_FILE, f"APM/{number}".encode(), session=number, sender=OTHER)
    FtpClient(Wire(server)).upload("APM/a", b"content", quiet)
    assert (card / "APM" / "a").read_bytes() == b"content"


# ---- the applet -------------------------------------------------------------------------------


def cut_after(wire: Wire, requests: int) -> Callable[[], bool]:
    return lambda: len(wire.requests) > requests


def card_with(folder: Path, content: bytes) -> Path:
    (folder / "APM" / "scripts").mkdir(parents=True, exist_ok=True)
    (folder / TARGET).write_bytes(content)
    return folder


def scripts_of(card: Path) -> dict[str, bytes]:
    return {one.name: one.read_bytes() for one in (card / "APM" / "scripts").iterdir()}


def test_the_applet_arrives_and_nothing_else_is_left(card: Path) -> None:
    assert install_over_link(FtpClient(Wire(FtpServer(card))), no_bar)
    assert scripts_of(card) == {"echowing.lua": applet_path().read_bytes()}


def test_an_older_one_is_replaced_and_the_same_one_left_alone(card: Path) -> None:
    card_with(card, b"-- older")
    (card / f"{TARGET}.old").write_text("-- of a run that was cut")
    wire = Wire(FtpServer(card))
    assert install_over_link(FtpClient(wire), no_bar)
    assert scripts_of(card) == {"echowing.lua": applet_path().read_bytes()}
    wire.requests.clear()
    assert not install_over_link(FtpClient(wire), no_bar)
    assert Op.WRITE_FILE not in {one.operation for one in wire.requests}


@pytest.mark.parametrize("room_bytes", [8, 20_000, 40_000])
def test_a_full_card_keeps_the_older_applet_and_no_rest(card: Path, room_bytes: int) -> None:
    card_with(card, b"-- older")
    with pytest.raises(EchowingError, match="full or broken"):
        install_over_link(FtpClient(Wire(FtpServer(card, room_bytes))), no_bar)
    assert scripts_of(card) == {"echowing.lua": b"-- older"}


class ForgetfulServer(FtpServer):
    """A card that acknowledges a write and keeps nothing of its last byte."""

    def _write(self, session, request):  # type: ignore[no-untyped-def]
        reply = super()._write(session, request)
        session.path.write_bytes(session.path.read_bytes()[:-1] + b"?")
        return reply


def test_a_card_that_gives_back_something_else_keeps_the_older_applet(card: Path) -> None:
    card_with(card, b"-- older")
    with pytest.raises(EchowingError, match="does not return what was written"):
        install_over_link(FtpClient(Wire(ForgetfulServer(card))), no_bar)
    assert scripts_of(card) == {"echowing.lua": b"-- older"}


def test_cut_anywhere_the_card_holds_a_whole_applet_or_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    new = b"-- newer\n" * 100
    source = tmp_path / "new.lua"
    source.write_bytes(new)
    monkeypatch.setattr(applet, "applet_path", lambda applet: source)
    cut_at = 0
    states: list[bytes | None] = []
    whole = False
    while not whole:
        cut_at += 1
        card = card_with(tmp_path / str(cut_at), b"-- older")
        wire = Wire(FtpServer(card))
        wire.lose = cut_after(wire, cut_at)
        try:
            install_over_link(FtpClient(wire), no_bar)
            whole = True
        except NoAnswerError:
            states.append(scripts_of(card).get("echowing.lua"))
            wire.lose = lambda: False
            install_over_link(FtpClient(wire), no_bar)
        assert scripts_of(card) == {"echowing.lua": new}
    assert len(states) > 20
    # Old, then none between two renames, then new: never a part.
    assert states == sorted(states, key=[b"-- older", None, new].index)
    assert states.count(None) <= 2


class StubbornServer(FtpServer):
    """Refuses to rename the new applet into place."""

    def _rename(self, session, request):  # type: ignore[no-untyped-def]
        if request.data.startswith(f"{TARGET}.new".encode()):
            raise OSError(errno.EACCES, "no")
        return super()._rename(session, request)


def test_an_older_applet_comes_back_where_the_new_one_is_refused(card: Path) -> None:
    card_with(card, b"-- older")
    with pytest.raises(FtpRefusedError, match="Permission denied"):
        install_over_link(FtpClient(Wire(StubbornServer(card))), no_bar)
    assert scripts_of(card)["echowing.lua"] == b"-- older"


def test_no_card_and_no_folder_are_told_apart(tmp_path: Path) -> None:
    with pytest.raises(EchowingError, match="has no SD card, or cannot use it"):
        install_over_link(FtpClient(Wire(FtpServer(None))), no_bar)
    with pytest.raises(EchowingError, match="no folder APM on the vehicle"):
        install_over_link(FtpClient(Wire(FtpServer(tmp_path))), no_bar)


def test_an_autopilot_without_checksums_is_read_back_all_the_same(card: Path) -> None:
    server = FtpServer(card)
    del server._table[Op.CALC_FILE_CRC32]
    wire = Wire(server)
    assert install_over_link(FtpClient(wire), no_bar)
    assert Op.READ_FILE in {one.operation for one in wire.requests}
    assert scripts_of(card) == {"echowing.lua": applet_path().read_bytes()}
