"""The order of the pairs in a training run, and the share of each process."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robustflow.core.errors import UsageError
from robustflow.training.data.find import Order

from ..refusals import refusal

pytestmark = pytest.mark.training


@given(count=st.integers(1, 300), block=st.integers(1, 12), seed=st.integers(0, 99), epoch=st.integers(0, 3))
def test_epoch_uses_every_pair_at_most_once_and_omits_less_than_one_update(count, block, seed, epoch):
    if count < block:
        refusal(lambda: Order(count, block, seed), UsageError, "--batch-size")
        return
    order = Order(count, block, seed)
    each = count - count % block
    places = [order.place(epoch * each + offset) for offset in range(each)]
    assert len(set(places)) == each
    assert set(places) <= set(range(count))


def test_order_differs_between_epochs_and_seeds():
    order, other = Order(200, 4, 0), Order(200, 4, 1)
    first = [order.place(n) for n in range(200)]
    assert first != [order.place(200 + n) for n in range(200)]
    assert first != [other.place(n) for n in range(200)]


def test_a_pair_that_cannot_be_read_is_replaced_by_another_each_time():
    order = Order(1000, 4, 0)
    assert len({order.place(7, attempt) for attempt in range(20)}) > 15
    assert order.place(7, 3) == Order(1000, 4, 0).place(7, 3)
