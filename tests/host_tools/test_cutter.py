"""What a radio does to the bytes on it: packets of its own, lost and damaged ones."""

import random

import pytest

from echowing.sim.world.cutter import ByteLoss, PacketCutter

# Any eight bytes of it are found in one place only.
BYTES = random.Random(0).randbytes(200_000)


def cutter(seed: int = 1, **loss: object) -> PacketCutter:
    return PacketCutter(ByteLoss(**loss), random.Random(seed))  # type: ignore[arg-type]


def gaps(arrived: bytes) -> list[tuple[int, int]]:
    """Where bytes of `BYTES` are missing and how many, in what arrived of them."""
    found, at, come = [], 0, 0
    while come < len(arrived) - 8:
        if arrived[come] != BYTES[at]:
            again = BYTES.index(arrived[come : come + 8], at)
            found.append((at, again - at))
            at = again
        come, at = come + 1, at + 1
    return found


def test_a_link_that_loses_nothing_leaves_every_byte() -> None:
    whole = cutter()

    assert whole.carry(BYTES) == BYTES
    assert not whole.has_cut


def test_a_share_of_the_packets_is_lost_and_the_rest_is_as_it_was() -> None:
    arrived = cutter(byte_loss=0.05).carry(BYTES)

    # 4000 packets of 50 bytes on average; 200 of them lost, standard deviation 14: 50 bytes each.
    assert 0.036 < 1.0 - len(arrived) / len(BYTES) < 0.064
    lost = [size for _, size in gaps(arrived[:40_000])]
    assert min(lost) >= 20
    # Two packets in a row are lost in one of 20.
    assert sum(size <= 80 for size in lost) > 0.8 * len(lost)


def test_packets_are_as_long_as_asked_for() -> None:
    lost = gaps(cutter(byte_loss=0.05, packet_bytes=(30, 30)).carry(BYTES))

    assert {size % 30 for _, size in lost} == {0}


@pytest.mark.parametrize("piece", [1, 13, 4096])
def test_it_does_not_matter_in_what_pieces_the_bytes_come(piece: int) -> None:
    whole = cutter(byte_loss=0.1, flip=0.2).carry(BYTES[:20_000])
    radio = cutter(byte_loss=0.1, flip=0.2)

    pieces = [BYTES[at : at + piece] for at in range(0, 20_000, piece)]
    cut = b"".join(map(radio.carry, pieces))
    assert cut[: len(whole)] == whole
    assert radio.has_cut


def test_a_packet_does_not_wait_for_bytes_that_come_much_later() -> None:
    """A beat of 21 bytes each second is lost as a whole, or not: it is alone in its packet."""
    radio = cutter(byte_loss=0.3, packet_bytes=(30, 80))

    lengths = [len(radio.carry(bytes(21), float(t_s))) for t_s in range(1000)]
    assert set(lengths) == {0, 21}
    assert 240 < lengths.count(0) < 360  # 300, standard deviation 14


def test_a_damaged_packet_has_one_wrong_bit() -> None:
    arrived = cutter(flip=1.0, packet_bytes=(50, 50)).carry(BYTES)

    wrong = [a ^ b for a, b in zip(arrived, BYTES, strict=True)]
    for at in range(0, len(BYTES), 50):
        assert sum(one.bit_count() for one in wrong[at : at + 50]) == 1
    assert {at % 50 for at, one in enumerate(wrong) if one} == set(range(50))


def test_a_seed_says_what_is_lost() -> None:
    assert cutter(1, byte_loss=0.1).carry(BYTES) == cutter(1, byte_loss=0.1).carry(BYTES)
    assert cutter(1, byte_loss=0.1).carry(BYTES) != cutter(2, byte_loss=0.1).carry(BYTES)


def test_a_loss_may_begin_and_end() -> None:
    radio = cutter()
    radio.loss = ByteLoss(byte_loss=1.0)
    assert radio.carry(BYTES[:100]) == b""
    radio.loss = ByteLoss()
    assert radio.carry(BYTES) == BYTES
