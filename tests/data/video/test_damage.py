"""The noise filter produces the same bytes as FFmpeg's filter and as a simple loop that follows its definition."""

from __future__ import annotations

import av
import pytest
from av.bitstream import BitStreamFilterContext
from hypothesis import given
from hypothesis import strategies as st

from robustflow.core.errors import UsageError
from robustflow.data.video.clip import ClipFile, read_packets
from robustflow.data.video.codec import Packet
from robustflow.data.video.damage import Damage, NoiseFilter, damage_packets

from . import clips


def by_ffmpeg(path, amount: int) -> list[bytes]:
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        noise = BitStreamFilterContext(f"noise={amount}", stream)
        packets = [p for p in container.demux(stream) if p.size]
        return [bytes(out) for packet in packets for out in noise.filter(packet)]


@pytest.fixture(scope="module")
def clip(tmp_path_factory) -> ClipFile:
    return clips.clip(tmp_path_factory.mktemp("clip") / "a.mp4", 40, 96, 128)


@pytest.mark.parametrize("amount", [1, 2, 3, 129, 2000, 65_537, 1_000_000, 50_000_000, 2**31 - 1])
def test_damaged_bytes_equal_those_of_ffmpeg(clip, amount):
    damage = Damage(amount)
    damaged = [packet.data for packet in damage_packets(read_packets(clip), damage)]
    clean = [packet.data for packet in read_packets(clip)]
    assert damaged == by_ffmpeg(clip.path, amount)
    assert damage.bytes_changed == sum(
        a != b for x, y in zip(damaged, clean, strict=True) for a, b in zip(x, y, strict=True)
    )
    assert damage.bytes_total == sum(map(len, clean))


@given(st.lists(st.binary(max_size=300), max_size=8), st.integers(1, 2000), st.integers(0, 2**32 - 1))
def test_damage_equals_the_naive_loop(packets, amount, state):
    noise, total, expected = NoiseFilter(amount), state, []
    noise.state = state  # large enough for the 32-bit state to wrap around
    for data in packets:
        out = bytearray(data)
        for i, byte in enumerate(data):
            total = (total + byte + 1) % 2**32
            if total % amount == 0:
                out[i] = total & 255
        expected.append(bytes(out))
    assert [noise(data)[0] for data in packets] == expected
    assert noise.state == total


def test_damage_lists_the_frames_it_hit():
    damage = Damage(7)
    packets = [Packet(bytes([0] * 6), 3), Packet(bytes([0]), 1), Packet(bytes([5]), 2)]
    out = list(damage_packets(packets, damage))
    assert [packet.index for packet in out] == [3, 1, 2]
    assert (damage.frames_hit, damage.bytes_changed) == ([1], 1)


@pytest.mark.parametrize("amount", [0, -1, 2**31, 1.5, True])
def test_invalid_amounts_of_damage_are_refused(amount):
    with pytest.raises(UsageError, match="noise amount"):
        NoiseFilter(amount)
