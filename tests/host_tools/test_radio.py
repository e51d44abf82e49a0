import random

import pytest

from echowing.sim.world.cutter import ByteLoss, PacketCutter
from echowing.sim.world.radio import Radio, RadioSettings


def radio(**settings: float) -> Radio:
    return Radio(RadioSettings(**settings), random.Random(1))


def arrivals(
    link: Radio, packets: int, every_s: float = 0.1, until_s: float = 100.0
) -> list[tuple[float, int]]:
    """(time, packet number) of everything that arrives, on a clock of 1 ms."""
    for number in range(packets):
        link.send(number * every_s, number.to_bytes(2, "big"))
    out: list[tuple[float, int]] = []
    for ms in range(int(until_s * 1000)):
        out += [(ms / 1000, int.from_bytes(p, "big")) for p in link.receive(ms / 1000)]
    return out


def test_packets_arrive_late_by_the_latency_and_in_order() -> None:
    got = arrivals(radio(latency_s=0.46), 5, until_s=2.0)

    assert [number for _, number in got] == [0, 1, 2, 3, 4]
    assert [t for t, _ in got] == pytest.approx([0.46, 0.56, 0.66, 0.76, 0.86], abs=0.002)


def test_loss_is_the_share_asked_for() -> None:
    got = arrivals(radio(loss=0.3), 2000, every_s=0.001, until_s=3.0)

    # 1400 expected, standard deviation 20.
    assert 1320 < len(got) < 1480


def test_jitter_delays_but_keeps_the_order() -> None:
    got = arrivals(radio(latency_s=0.1, jitter_s=0.5), 200, every_s=0.01, until_s=4.0)

    assert [number for _, number in got] == list(range(200))
    delays = [t - number * 0.01 for t, number in got]
    assert min(delays) >= 0.1
    assert max(delays) > 0.3


def test_reordered_packets_are_overtaken() -> None:
    got = arrivals(radio(reorder=0.1, reorder_s=0.3), 500, every_s=0.05, until_s=30.0)

    numbers = [number for _, number in got]
    assert sorted(numbers) == list(range(500))
    assert numbers != sorted(numbers)


def test_bandwidth_makes_packets_queue() -> None:
    # Two bytes each at 20 bytes a second: one every 0.1 s, sent all at once.
    got = arrivals(radio(bandwidth_bytes_ps=20.0), 5, every_s=0.0, until_s=2.0)

    assert [t for t, _ in got] == pytest.approx([0.1, 0.2, 0.3, 0.4, 0.5], abs=0.002)


def test_a_radio_that_loses_bytes_brings_the_rest_of_a_frame_at_its_time() -> None:
    cutter = PacketCutter(ByteLoss(byte_loss=0.3, packet_bytes=(20, 80)), random.Random(2))
    link = Radio(RadioSettings(latency_s=0.46), random.Random(1), cutter)
    for number in range(200):
        link.send(number * 0.1, bytes([number]) * 50)

    assert link.receive(0.4) == []
    lengths = [len(packet) for packet in link.receive(30.0)]
    # 7000 of 10,000 bytes; 200 packets, standard deviation 360 bytes.
    assert 5600 < sum(lengths) < 8400
    assert 0 in lengths
    assert 50 in lengths
    assert any(0 < length < 50 for length in lengths)


def test_a_silent_radio_carries_nothing() -> None:
    link = radio()
    link.silent = True

    assert arrivals(link, 5, until_s=1.0) == []
