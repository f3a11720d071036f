"""Fine-tuned SAMFlow-H against the original's outputs. The weights take 2.6 GB."""

import pytest

pytest.importorskip("torch", reason="needs the torch extra")

from robustflow.models.networks.samflow import SamFlow

from ..shared_data import shared_folder
from .pack import Pack
from .samflow_case import check_case

pytestmark = [pytest.mark.parity, pytest.mark.torch, pytest.mark.slow]
PACK = "samflow_h"


@pytest.fixture(scope="module")
def net():
    return Pack(shared_folder("parity", PACK)).fill(SamFlow("huge_finetuned"), "keys_ft.json")


@pytest.mark.expected("_ft")
def test_features_and_flow(pack, net, case):
    check_case(pack, net, case, "_ft")
