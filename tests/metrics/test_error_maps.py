import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robustflow.metrics.error_maps import epe_map, error_sum, magnitude_map

from . import naive
from .strategies import flows, masks, shapes


@given(st.data())
def test_error_map_and_sum_equal_the_naive_loop_bit_for_bit(data):
    shape = data.draw(shapes)
    a, b = data.draw(flows(shape, finite=False)), data.draw(flows(shape, finite=False))
    mask = data.draw(masks(shape))
    errors = epe_map(a, b)
    n, total = 0, 0.0
    for y, x in naive.pixels(mask):
        expected = naive.distance(a[y, x], b[y, x])
        if expected is None:
            assert np.isnan(errors[y, x])
        else:
            assert errors[y, x] == expected
            n, total = (n + 1, total + expected) if mask[y, x] else (n, total)
    assert error_sum(errors, mask) == (n, total)


@given(st.data())
def test_magnitude_is_the_distance_from_no_motion(data):
    flow = data.draw(flows(data.draw(shapes), finite=False))
    np.testing.assert_array_equal(magnitude_map(flow), epe_map(flow, np.zeros_like(flow)))


def _unaligned(flow):
    bytes_ = np.zeros(flow.nbytes + 1, np.uint8)
    view = bytes_[1:].view(np.float32).reshape(flow.shape)
    view[...] = flow
    return view


def _read_only(flow):
    copy = flow.copy()
    copy.flags.writeable = False
    return copy


LAYOUTS = {
    "column order": np.asfortranarray,
    "planes first": lambda flow: np.ascontiguousarray(flow.transpose(2, 0, 1)).transpose(1, 2, 0),
    "mirrored": lambda flow: np.ascontiguousarray(flow[::-1, ::-1])[::-1, ::-1],
    "every second": lambda flow: np.repeat(flow, 2, axis=1)[:, ::2],
    "read-only": _read_only,
    "unaligned": _unaligned,
}


@pytest.mark.parametrize("name", LAYOUTS)
def test_memory_layout_changes_no_bit(name):
    rng = np.random.default_rng(0)
    a, b = rng.normal(0, 9, (2, 37, 53, 2)).astype(np.float32)
    mask = rng.random((37, 53)) < 0.7
    changed = LAYOUTS[name](a)
    np.testing.assert_array_equal(changed, a)
    errors = epe_map(changed, b)
    assert errors.tobytes() == epe_map(a, b).tobytes()
    assert error_sum(np.asfortranarray(errors), np.asfortranarray(mask)) == error_sum(errors, mask)
