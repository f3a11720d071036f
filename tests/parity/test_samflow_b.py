"""SAMFlow-B against the original's outputs."""

import pytest

pytest.importorskip("torch", reason="needs the torch extra")

from robustflow.models.networks.samflow import SamFlow

from ..shared_data import shared_folder
from .pack import Pack
from .samflow_case import check_24_iterations, check_case

pytestmark = [pytest.mark.parity, pytest.mark.torch, pytest.mark.slow]
PACK = "samflow_b"


@pytest.fixture(scope="module")
def net():
    return Pack(shared_folder("parity", PACK)).fill(SamFlow("base"))


def test_features_and_flow(pack, net, case):
    check_case(pack, net, case)


def test_twice_the_iterations(pack, net, case):
    if "flow_24_iters" not in pack.expected(case):
        pytest.skip("a case without 24 iterations")
    check_24_iterations(pack, net, case)
