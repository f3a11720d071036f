"""Test the arguments for ptlflow's constructors with classes that have the same signatures as its models."""

from collections.abc import Sequence

import pytest

from robustflow.core.errors import UsageError
from robustflow.models.ptlflow.models import constructor_options

WIDTHS = (64, 96)


class Net:
    def __init__(self, widths=WIDTHS, strides=WIDTHS, iters=32, backbone_weights="fetched", levels=3): ...

    __init__.__annotations__ = {"widths": Sequence[int], "strides": tuple[int, int]}


class Smaller(Net):
    def __init__(self, levels=2, **kwargs):
        super().__init__(levels=levels, **kwargs)


class Pyramid(Net):
    def __init__(self, iters=(4, 6)): ...


@pytest.mark.parametrize("net", [Net, Smaller])
def test_sequence_options_of_all_base_classes_become_lists(net):
    options, rounds = constructor_options("net", net, None)
    assert options == {"widths": [64, 96], "backbone_weights": None, "iters": 32}
    assert rounds == 32
    options["widths"][0] = 1
    assert constructor_options("net", net, 5) == ({"widths": [64, 96], "backbone_weights": None, "iters": 5}, 5)
    assert WIDTHS == (64, 96)


def test_arguments_of_a_base_class_are_hidden_by_a_closed_constructor():
    assert constructor_options("pyramid", Pyramid, None) == ({}, None)
    with pytest.raises(UsageError, match="model 'pyramid' does not have exactly one number of iterations"):
        constructor_options("pyramid", Pyramid, 3)
