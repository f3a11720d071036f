"""A run for `tests.made_rows.made_run`, which replaces its rows."""

import numpy as np
import pytest

from robustflow.api import evaluate
from robustflow.images.io import write_image
from robustflow.testing import ZeroFlow


@pytest.fixture(scope="session")
def base(tmp_path_factory):
    folder = tmp_path_factory.mktemp("base")
    for index in range(2):
        write_image(folder / f"{index}.png", np.full((24, 24, 3), 40 + index, np.uint8))
    return evaluate(ZeroFlow(), "folder", folder, folder / "run", corruptions=["contrast"], severities=[1])
