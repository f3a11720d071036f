"""Memory slots shared by two processes."""

import multiprocessing
import os

import numpy as np
import pytest

from robustflow.run.engines.feeder import BUDGET, MOST_SLOTS, SharedSlots


def _add_one(pipe, slots):
    slot, slot_bytes, shape = pipe.recv()
    frames = slots.frames(slot, slot_bytes, shape)
    slots.flow(slot, slot_bytes, (*shape[1:3], 2))[:] = frames[0, ..., :2].astype(np.float32) + 1
    pipe.send(None)


def test_frames_and_flows_pass_through_slots_unchanged():
    slots, (ours, theirs) = SharedSlots(4), multiprocessing.Pipe()
    child = multiprocessing.get_context("spawn").Process(target=_add_one, args=(theirs, slots))
    child.start()
    shape = (2, 30, 40, 3)
    assert slots.fit(30 * 40 * 8)
    slots.take()
    slot = slots.take()
    frames = slots.frames(slot, slots.slot_bytes, shape)
    frames[:] = np.random.default_rng(0).integers(0, 256, shape)
    expected = frames[0, ..., :2].astype(np.float32) + 1
    ours.send((slot, slots.slot_bytes, shape))
    assert ours.poll(60)
    np.testing.assert_array_equal(slots.flow(slot, slots.slot_bytes, (30, 40, 2)), expected)
    child.join()
    slots.close()


@pytest.mark.parametrize("size", [1, 4096, 375 * 1242 * 8, 2160 * 3840 * 8, BUDGET])
def test_memory_is_bounded_and_there_are_never_too_few(size):
    slots = SharedSlots(6)
    assert slots.fit(size)
    assert slots.slot_bytes >= size
    assert 6 <= slots.count <= MOST_SLOTS
    assert slots.count == 6 or slots.count * slots.slot_bytes <= BUDGET
    slots.close()


def test_a_slot_costs_memory_from_its_first_use_on():
    slots = SharedSlots(4)
    slots.fit(2**20)
    for _ in range(20):
        slot = slots.take()
        slots.frames(slot, slots.slot_bytes, (1, 2**10, 2**10, 1))[:] = 7
        slots.put_back(slot)
    assert os.fstat(slots._descriptor).st_blocks * 512 == slots.slot_bytes
    assert slots.free == slots.count
    slots.close()


def test_larger_frames_wait_until_the_smaller_are_back():
    slots = SharedSlots(4)
    slots.fit(1000)
    slot = slots.take()
    assert slots.fit(900)
    assert not slots.fit(10**6)
    slots.put_back(slot)
    assert slots.fit(10**6)
    assert slots.free == slots.count
    slots.close()


def test_the_memory_is_mapped_once_however_many_slots_are_used():
    slots = SharedSlots(4)
    slots.fit(2**16)
    maps = []
    for _ in range(slots.count):
        slots.frames(slots.take(), slots.slot_bytes, (1, 2**8, 2**8, 1))
        maps.append(slots._map)
    assert all(one is maps[0] for one in maps)
    slots.close()


def test_views_of_small_slots_outlive_larger_ones():
    slots = SharedSlots(4)
    slots.fit(BUDGET // MOST_SLOTS)
    places = [slots.take() for _ in range(slots.count)]
    view = slots.frames(places[-1], slots.slot_bytes, (1, 64, 64, 3))
    view[:] = 5
    for place in places:
        slots.put_back(place)
    assert slots.fit(BUDGET // MOST_SLOTS * 3 // 2), "fewer bytes in total"
    assert slots.count * slots.slot_bytes < BUDGET
    assert (view == 5).all(), "a process that reads memory beyond the end would be killed"
    slots.close()
