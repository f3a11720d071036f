"""Corruptions from installed packages are available by name without changes to RobustFlow, and their source is part of
the identity.
"""

import os
import subprocess
import sys

from .rain import write_rain

SCRIPT = """
import numpy as np
from robustflow.corruptions import CORRUPTIONS, corrupt, load_corruption
from robustflow.corruptions.api import user_sources
from robustflow.corruptions.stack import needs_depth
from robustflow.core.errors import UsageError
frame = np.full((24, 36, 3), 9, np.uint8)
assert "rain" in CORRUPTIONS.names()
assert (corrupt(frame, frame, "fog+rain", 3)[0] != corrupt(frame, frame, "fog", 3)[0]).any()
print(user_sources(names=["fog+rain:2"])["corruptions"]["rain"])
assert needs_depth("fog+haze") and not needs_depth("fog+rain")
for name in ("sleet", "gone", "hail"):
    try:
        load_corruption(name)
    except UsageError as error:
        print(error)
"""


HAZE = """
import numpy as np
from robustflow.corruptions import DepthCorruption
class Haze(DepthCorruption):
    paper_severities = (1, 2, 3, 4, 5)
    def draw_scene(self, rng, severity, depth):
        return depth.maps
    def apply(self, frame, state, index):
        return frame.copy()
"""


def test_corruption_of_an_entry_point_is_registered(tmp_path):
    site = tmp_path / "site"
    info = site / "weather-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: weather\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(
        "[robustflow.corruptions]\nrain = rain_module:Rain\nsleet = rain_module:Rain\nhaze = haze_module:Haze\n"
        "gone = no_module:Gone\nhail = haze_module:np\n"
    )
    (site / "haze_module.py").write_text(HAZE)
    write_rain(site)

    done = subprocess.run(
        [sys.executable, "-c", SCRIPT], env={**os.environ, "PYTHONPATH": os.pathsep.join([str(site), *sys.path])},
        capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    source, *sentences = done.stdout.splitlines()
    assert len(source) == 16
    for sentence, expected in zip(
        sentences,
        ("entry point 'sleet' provides a corruption named 'rain'",
         "entry point 'gone = no_module:Gone' of an installed package cannot be imported: ModuleNotFoundError: ",
         "has no method draw, so it is not a corruption"),
        strict=True,
    ):  # fmt: skip
        assert expected in sentence
