"""Damaged streams: the bytes are FFmpeg's, no frame is lost without a replacement, every frame keeps its time."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robustflow.core.errors import DataError
from robustflow.data.video.clip import ClipFile, read_header, read_packets
from robustflow.data.video.codec import Decoder, Options, Packet, crf, lossless
from robustflow.data.video.variants import (
    REORDER,
    Damage,
    Fill,
    corrupted_stream,
    damage_packets,
    fill_lost,
    pictures_in_order,
)
from tests.refusals import refusal

from . import clips

COUNT, HEIGHT, WIDTH = 60, 96, 128
INTRA = lossless("ultrafast", every_frame=True)
TEN = lossless("veryfast") | {"g": "10"}


def decode(clip, packets) -> tuple[list[np.ndarray], Fill]:
    fill = Fill(clip.count)
    decoder = Decoder(read_header(clip), *clip.stored_size)
    return [picture for _, picture in fill_lost(decoder.decode(packets), fill)], fill


def without_packets(packets, indices) -> list[Packet]:
    """Overwrite the packets of some frames with bytes that cannot be decoded."""
    return [Packet(b"\xff" * len(p.data), p.index) if p.index in indices else p for p in packets]


@pytest.fixture(scope="module")
def made(tmp_path_factory):

    made: dict[str, ClipFile] = {}

    def make(options: Options, count: int = COUNT, height: int = HEIGHT, width: int = WIDTH) -> ClipFile:
        name = repr((options, count, height, width))
        if name not in made:
            made[name] = clips.clip(tmp_path_factory.mktemp("clip") / "a.mp4", count, height, width, options)
        return made[name]

    return make


@pytest.mark.parametrize("amount", [50_000_000, 1_000_000, 100_000, 20_000, 5_000, 2_000])
def test_frames_of_intact_packets_are_decoded_exactly(made, amount):
    """If frames do not depend on each other, every undamaged frame is decoded correctly at its position."""
    clip, pictures = made(INTRA), clips.pictures(COUNT, HEIGHT, WIDTH)
    stream = corrupted_stream(clip, "bit_error", amount)
    shown = dict(stream.pictures)
    hit = set(stream.damage.frames_hit)
    assert sorted(shown) == list(range(COUNT))
    for index in set(range(COUNT)) - hit:
        assert clips.shown_as(stream.fill, index) == index
        if (shown[index] == pictures[index]).all():
            continue
        assert index - 1 in hit  # a damaged frame can leave state in FFmpeg's decoder that affects the next frame
        distances = [np.abs(shown[index].astype(int) - picture).mean() for picture in pictures]
        assert int(np.argmin(distances)) == index
    assert bool(hit) == (amount <= 100_000)


@pytest.mark.parametrize("encoding", [lossless("veryfast"), crf(20)], ids=["lossless", "crf"])
@pytest.mark.parametrize("amount", [100_000, 5_000, 500, 50])
def test_predicted_streams_keep_the_frame_count_and_are_exact_until_the_first_error(made, encoding, amount):
    clip = made(encoding)
    clean, _ = decode(clip, read_packets(clip))
    stream = corrupted_stream(clip, "bit_error", amount)
    shown = [picture for _, picture in stream.pictures]
    assert len(shown) == COUNT
    # in coded order, frames before the first damaged packet do not depend on it
    order = [packet.index for packet in read_packets(clip)]
    hit = set(stream.damage.frames_hit)
    before = order[: next((i for i, index in enumerate(order) if index in hit), len(order))]
    assert all((shown[index] == clean[index]).all() for index in before)


@pytest.mark.parametrize(
    ("encoding", "ruins", "lost"),
    [
        (INTRA, {0, 1}, [(0, 1, 2)]),
        (INTRA, {7, 8, 27, 28, 29}, [(7, 8, 6), (27, 29, 26)]),
        (TEN, {0}, [(0, 9, 10)]),  # no frame can be decoded before the next intra-coded frame
    ],
    ids=["first pictures", "middle and tail", "first idr of a predicted stream"],
)
def test_lost_frames_show_the_nearest_decoded_frame(made, encoding, ruins, lost):
    clip, pictures = made(encoding, 30, 48, 64), clips.pictures(30)
    shown, fill = decode(clip, without_packets(read_packets(clip), ruins))
    assert fill.lost == lost
    assert all((shown[index] == pictures[clips.shown_as(fill, index)]).all() for index in range(30))


@pytest.mark.parametrize("ruins", [{0}, set(range(30))], ids=["the only idr", "all"])
def test_stream_without_a_decodable_frame_is_refused(made, ruins):
    clip = made(lossless("veryfast"), 30, 48, 64)
    refusal(lambda: decode(clip, without_packets(read_packets(clip), ruins)), DataError, "stream")


def check_damage(packets: list[Packet], amount: int) -> None:
    """Compare the bytes, and the counts of a record, with the running sum modulo 2**32 of all bytes of the stream."""
    damage, total, expected, hit = Damage(amount), 0, [], {}
    for packet in packets:
        clean = np.frombuffer(packet.data, np.uint8)
        sums = (total + np.cumsum(clean.astype(np.uint64) + 1)) % 2**32
        damaged = np.where(sums % amount == 0, sums % 256, clean).astype(np.uint8)
        total = int(sums[-1])
        expected.append(Packet(damaged.tobytes(), packet.index))
        hit[packet.index] = int((damaged != clean).sum())
    assert list(damage_packets(packets, damage)) == expected
    assert damage.frames_hit == [index for index, count in hit.items() if count]
    assert damage.bytes_changed == sum(hit.values())


@given(st.lists(st.binary(min_size=1, max_size=300), max_size=8), st.integers(1, 2000))
def test_damage_of_short_packets_equals_the_definition(packets, amount):
    check_damage([Packet(data, index) for index, data in enumerate(packets)], amount)


@pytest.mark.parametrize("amount", [1, 65_537, 50_000_000, 2**31 - 1])
def test_damage_of_a_long_stream_equals_the_definition(amount):
    """The sum of the bytes exceeds 2**32."""
    check_damage([Packet(b"\xff" * 12_000_000, 3), Packet(bytes(range(256)) * 40_000, 1)], amount)


def picture(index: int) -> np.ndarray:
    return np.full((3, 2), index % 251, np.uint8)


@given(st.data())
def test_every_frame_shows_the_last_decoded_one_before_it(data):
    count = data.draw(st.integers(1, 60))
    decoded = sorted(data.draw(st.sets(st.integers(0, count - 1), min_size=1)))
    fill = Fill(count)
    shown = list(fill_lost([(index, picture(index)) for index in decoded], fill))
    assert [index for index, _ in shown] == list(range(count))
    for index, what in shown:
        before = [k for k in decoded if k <= index]
        source = before[-1] if before else decoded[0]
        assert what[0, 0] == source % 251
        assert clips.shown_as(fill, index) == source
    assert fill.frames_lost == count - len(decoded)


@given(st.permutations(range(20)), st.lists(st.integers(-5, 40), max_size=10))
def test_order_of_arrival_does_not_matter(order, strangers):
    """Test twenty frames in any order, with duplicates and indices outside the clip."""
    arrivals = [(index, picture(index)) for index in order]
    arrivals += [(index, picture(index)) for index in strangers]
    fill = Fill(20)
    assert [index for index, _ in pictures_in_order(arrivals, fill)] == list(range(20))
    assert fill.dropped == len(strangers)


def test_buffer_of_waiting_frames_is_bounded():
    """A frame that arrives too late for the buffer is dropped."""
    late = REORDER + 5
    arrivals = [(index, picture(index)) for index in range(1, 1 + late)] + [(0, picture(0))]
    fill = Fill(late + 1)
    shown = [(index, int(what[0, 0])) for index, what in fill_lost(arrivals, fill)]
    assert shown[0] == (0, 1)
    assert fill.dropped == 1
