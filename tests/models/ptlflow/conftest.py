"""The ptlflow library, imported as the adapter imports it."""

import pytest

from robustflow import load_model


@pytest.fixture(scope="session")
def library():
    pytest.importorskip("ptlflow", reason="needs the ptlflow extra")
    load_model("raft", checkpoint="random", device="cpu")
    import ptlflow

    return ptlflow
