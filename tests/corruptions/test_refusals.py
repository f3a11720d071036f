"""What is not a corruption, a severity, a frame, a depth or a lens is refused, and the error names it."""

import numpy as np
import pytest
from PIL import Image

from robustflow.core.errors import DataError, UsageError
from robustflow.core.rng import Rng
from robustflow.corruptions import corrupt, corrupt_clip, load_corruption
from robustflow.corruptions.blur import PsfBlur
from robustflow.corruptions.condition import condition_of
from robustflow.corruptions.depth.precipitation import Rain3d, Snow3d
from robustflow.corruptions.optics.lens import refractive_index
from robustflow.corruptions.optics.psf_field import PsfField
from robustflow.corruptions.registry import FURTHER
from robustflow.corruptions.transform import CorruptionTransform
from robustflow.report.gallery.ssim import Ssim

from ..refusals import refusal
from .pictures import plane, scene

FRAME = np.zeros((40, 56, 3), np.uint8)
OTHER_SIZE = scene(20, 30)
LACKING = 5
"""Severity of saturate that the calibrated scale lacks."""
ARGUMENTS = [
    ({"severity": 1}, "corruption"),
    ({"corruption": "fog"}, "severity"),
    *(({"corruption": "fog", "severity": 3, "seed": seed}, "seed") for seed in ("5", 5.0, None, True)),
    *(({"corruption": "fog", "severity": level}, level) for level in (0, 6, -1, True)),
    ({"corruption": "fog", "severity": 3, "scale": None}, "None"),
    ({"corruption": "fog", "severity": 3, "scale": "calibratd"}, "calibratd"),
    ({"corruption": "fog", "severity": 3, "variant": "bgr"}, "bgr"),
    ({"corruption": "fog", "severity": 3, "variant": "reference", "scale": "calibrated"}, "reference"),
    ({"corruption": "saturate", "severity": 3, "variant": "reference-bgr", "scale": "calibrated"}, "reference-bgr"),
    ({"corruption": "saturate", "severity": LACKING, "scale": "calibrated"}, "saturate"),
    ({"corruption": f"contrast+saturate:{LACKING}", "severity": 3, "scale": "calibrated"}, "saturate"),
]
"""Arguments of `corrupt`."""
NAMES = ["fog+", "+fog", "fog:", "fog:x+snow", "fog:0+snow", "fog:6", "foggy+snow", "fog:\u0663", "fog:" + 5000 * "1"]
"""Names of stacks."""
IMAGES = [
    (FRAME.astype(np.uint16), "uint16"),
    (FRAME.astype(np.float64), "float64"),
    (np.full((20, 20, 3), np.nan, np.float32), "nan to nan"),
    (np.full((20, 20, 3), 1.01, np.float32), "1.01 to 1.01"),
    (np.full((20, 20, 3), -0.1, np.float32), "-0.1 to -0.1"),
    (np.zeros((20, 20, 4), np.uint8), "(20, 20, 4)"),
    (np.zeros((0, 20, 3), np.uint8), "(0, 20, 3)"),
    ([FRAME, FRAME[:, :-1]], "(40, 55, 3)"),
    ([], "images"),
    ("image.png", "str"),
    (None, "NoneType"),
    (Image.new("RGB", (20, 20)), "Image"),
]
"""Images given to a transform."""
TRANSFORMS = [
    ({"names": ["fogg"]}, "fogg"),
    ({"names": "fog"}, "names"),
    ({"names": []}, "names"),
    ({"names": ["fog+h264_crf"]}, "h264_crf"),
    ({"names": ["fog_3d"]}, "fog_3d"),
    ({"names": ["snow+fog_3d:2"]}, "snow+fog_3d:2"),
    ({"names": ["saturate"], "severities": [LACKING], "scale": "calibrated"}, "saturate"),
    ({"severities": [0]}, "0"),
    ({"severities": []}, "severities"),
    ({"severities": 3}, "severities"),
    ({"probability": 1.5}, "probability"),
    ({"probability": float("nan")}, "probability"),
    ({"seed": "1"}, "seed"),
]
"""Arguments of a transform."""


def through_a_telescope(kind):
    return kind().draw_scene(Rng.of("t"), 5, plane(5.0, (60, 90), focal=1e9))


def around_a_pair(name, first):
    """Corrupt a frame before or after the pair, which has no depth."""
    return list(corrupt_clip([FRAME] * 3, name, 2, first=first, depth=scene(40, 56)))


CASES = [
    *((lambda given=given: corrupt(FRAME, FRAME, **given), UsageError, culprit) for given, culprit in ARGUMENTS),
    *((lambda name=name: condition_of(name).check(), UsageError, None) for name in NAMES),
    *(
        (lambda mode=mode: corrupt(Image.new(mode, (8, 8)), corruption="fog", severity=1), DataError, mode)
        for mode in ("RGBA", "I;16", "F", "CMYK")
    ),
    *((lambda image=image: CorruptionTransform(["contrast"])(image), DataError, culprit) for image, culprit in IMAGES),
    *((lambda given=given: CorruptionTransform(**given), UsageError, culprit) for given, culprit in TRANSFORMS),
    *(
        (lambda name=name, depth=depth: corrupt(FRAME, FRAME, name, 3, depth=depth), error, name)
        for name in ("fog_3d", "snow_3d", "near_focus", "motion_blur_3d")
        for depth, error in ((None, UsageError), (OTHER_SIZE, DataError), (OTHER_SIZE.maps[0], UsageError))
    ),
    *(
        (
            lambda name=name, at=at: [*corrupt_clip([FRAME] * 3, name, 2, first=at, depth=scene(40, 56))],
            UsageError,
            name,
        )
        for name in (*FURTHER["depth"], "fog+fog_3d:2")
        for at in (-1, 0)
    ),
    *((lambda kind=kind: through_a_telescope(kind), UsageError, "camera") for kind in (Rain3d, Snow3d)),
    (lambda: load_corruption("bit_error", scale="calibrated").parameter(1), UsageError, "bit_error"),
    (lambda: PsfBlur(severities=(0.0296, 0.0832, 0.1102, 0.1588, 0.5)), UsageError, "psf_blur"),
    (lambda: refractive_index("NBK7", 0.5), UsageError, "NBK7"),
    (lambda: Ssim(FRAME)(FRAME[:, :-1]), DataError, "40x55"),
    *(
        (lambda shape=shape, value=value: PsfField(np.full(shape, value)), DataError, "PSF stack")
        for shape in ((64, 3, 61, 61), (63, 3, 61, 61), (64, 3, 61))
        for value in (0.0, np.nan)
    ),
]


@pytest.mark.parametrize(("call", "error", "culprit"), CASES)
def test_impossible_request_is_refused(call, error, culprit):
    if culprit is None:  # a part of the name
        with pytest.raises(error):
            call()
    else:
        refusal(call, error, culprit)
