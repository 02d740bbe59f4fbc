"""Captured traffic: what networks and capturing programs make of datagrams, and damage."""

import struct
from pathlib import Path

import pytest
from support.packets import START_NS, block, pcap, pcapng, udp4, udp6

from farfield.datasets import captures
from farfield.datasets.turns import find_streams
from farfield.errors import FileFormatError
from farfield.files.captures import Losses, address_of, datagrams

PAYLOADS = [bytes([number]) * 40 for number in range(3)]
TIMES_NS = [START_NS + 1_000_000 * number for number in range(3)]


def contents(path: Path, losses: Losses | None = None) -> list[tuple[int, bytes]]:
    with path.open("rb") as file:
        return [(datagram.time_ns, datagram.content(file)) for datagram in datagrams(path, losses)]


def written(folder: Path, content: bytes) -> Path:
    path = folder / "a.pcap"
    path.write_bytes(content)
    return path


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("resolution", [9, 6, 3, 0x80 | 30])
def test_pcapng_holds_what_pcap_holds(tmp_path: Path, order: str, resolution: int) -> None:
    frames = [udp4(payload) for payload in PAYLOADS]
    path = written(tmp_path, pcapng(frames, TIMES_NS, order=order, resolution=resolution))
    got = contents(path)
    assert [content for _, content in got] == PAYLOADS
    assert [time_ns for time_ns, _ in got] == pytest.approx(TIMES_NS, abs=1)


def test_pcapng_with_sections_of_both_byte_orders_and_other_blocks(tmp_path: Path) -> None:
    frames = [udp4(payload) for payload in PAYLOADS]
    simple = block(3, struct.pack("<I", len(frames[0])) + frames[0])
    both = pcapng(frames, TIMES_NS) + block(5, bytes(8)) + simple + pcapng(frames[:1], TIMES_NS[:1], order=">")
    got = contents(written(tmp_path, both))
    assert [content for _, content in got] == [*PAYLOADS, PAYLOADS[0], PAYLOADS[0]]


def test_ipv6_behind_options_and_in_fragments(tmp_path: Path) -> None:
    payload = bytes(range(256)) * 4
    frames = udp6(payload) + udp6(payload, fragment=200)[::-1]
    path = written(tmp_path, pcap(frames))
    assert [content for _, content in contents(path)] == [payload, payload]
    assert {address_of(datagram.source) for datagram in datagrams(path)} == {"::1"}


def test_what_is_missing_is_counted(tmp_path: Path) -> None:
    whole = udp4(PAYLOADS[0])
    cut = struct.pack("<IIII", 5, 0, 50, len(whole)) + whole[:50]
    halves = udp6(bytes(1000), fragment=400)[:2]
    content = pcap([whole, *halves]) + cut + struct.pack("<IIII", 5, 0, 90, 90) + b"abc"
    losses = Losses()
    assert [content for _, content in contents(written(tmp_path, content), losses)] == PAYLOADS[:1]
    assert (losses.cut, losses.incomplete, losses.torn) == (1, 1, True)
    assert [sentence.split()[0] for sentence in losses.notes] == ["1", "1", "The"]


def test_other_traffic_counts_among_the_records_that_are_looked_at(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    other = bytearray(udp4(PAYLOADS[0]))
    other[23] = 6  # TCP
    path = written(tmp_path, pcap([bytes(other)] * 5 + [udp4(PAYLOADS[1])]))
    assert [len(list(datagrams(path, most_records=most))) for most in (5, 6, None)] == [0, 1, 1]
    packet = bytes.fromhex("ffee") * 600 + bytes(4) + bytes([0x37, 0x22])  # a Velodyne's
    path = written(tmp_path, pcap([bytes(other)] * 9 + [udp4(packet)]))
    assert [len(find_streams(path, None, most).streams) for most in (9, 10)] == [0, 1]
    for most in (9, 10):
        monkeypatch.setattr(captures, "_MOST_RECORDS", most)
        assert captures.holds_sensor(tmp_path) == (most == 10)


def test_every_cut_of_a_capture_is_read_as_far_as_it_goes(tmp_path: Path) -> None:
    for write, start in ((pcap, 24), (pcapng, 28 + 32)):
        ends = [len(write([udp4(payload) for payload in PAYLOADS[:count]], TIMES_NS[:count])) for count in range(4)]
        content = write([udp4(payload) for payload in PAYLOADS], TIMES_NS)
        for end in range(start, len(content), 7):
            losses = Losses()
            assert len(contents(written(tmp_path, content[:end]), losses)) == sum(end >= whole for whole in ends[1:])
            assert losses.torn == (end not in ends)


@pytest.mark.parametrize(
    ("content", "part"),
    [
        (block(0x0A0D0D0A, struct.pack("<IHHq", 7, 1, 0, -1)), "1a2b3c4d"),
        (pcapng([], []) + block(6, struct.pack("<IIIII", 4, 0, 0, 0, 0)), "one of 1 interfaces"),
        (pcapng([], []) + block(6, struct.pack("<IIIII", 0, 0, 0, 500, 500)), "500 bytes"),
        (pcapng([], []) + block(6, struct.pack("<IIIII", 0, 0, 0, 1 << 30, 0)), "at most"),
        (pcapng([], []) + block(6, struct.pack("<IIIII", 0, 0xFFFFFFFF, 0, 0, 0)), "a time"),
        (pcapng([], [], resolution=3) + struct.pack("<II", 6, 13) + bytes(20), "a multiple of 4"),
        (pcapng([], []) + struct.pack("<II", 6, 1 << 30) + bytes(20), "a multiple of 4"),
        (pcapng([], []) + struct.pack("<IIII", 5, 16, 0, 20), "once more at its end"),
        (pcapng([], [], resolution=200 & 0x7F | 0x60), "a resolution"),
        (block(0x0A0D0D0A, struct.pack("<IHHq", 0x1A2B3C4D, 1, 0, -1)) + block(1, bytes([105, 0]) + bytes(6)), "105"),
        (block(0x0A0D0D0A, struct.pack("<IHHq", 0x1A2B3C4D, 1, 0, -1)) + block(1, bytes(4)), "8 bytes"),
    ],
)
def test_damaged_blocks_are_refused(tmp_path: Path, content: bytes, part: str) -> None:
    if part == "a time":  # seconds beyond 64 bits: parts of a second of one second
        content = content.replace(struct.pack("<HHB3x", 9, 1, 9), struct.pack("<HHB3x", 9, 1, 0))
    with pytest.raises(FileFormatError, match=part):
        contents(written(tmp_path, content))
