"""RAW noise: what a sensor adds to a picture, through the whole chain of a camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...random.rng import Rng
from ...sample import Frame
from ..base import Corruption
from .camera import CameraColours, draw_camera
from .exposure import Sensor, exposed, sensor_at
from .mosaic import developed, light_on_sensor


@dataclass(frozen=True)
class RawState:
    """What a pair shares: the camera and how noisy its sensor is. `stream` names the streams of its frames."""

    camera: CameraColours
    sensor: Sensor
    stream: Rng


class RawNoise(Corruption):
    """The frame taken again by a noisy sensor; `severities` are ISO numbers.

    The picture is taken back to the light on a sensor (`camera`, `mosaic`), exposed with photon and read noise
    (`exposure`), and developed again: denoising, white balance, demosaicing, colours, gamma and tone curve. Camera and
    gains are drawn once for the pair; the noise is new in each frame. In none of the paper's averages.
    """

    name = "raw_noise"
    family = "sensor"
    paper_severities = (800, 1600, 3200, 6400, 12800)

    def draw(self, rng: Rng, severity: int, shape: tuple[int, int]) -> RawState:
        """The camera, and the stream that frames spawn theirs from."""
        return RawState(draw_camera(rng.spawn("camera")), sensor_at(self.parameter(severity)), rng)

    def apply(self, frame: Frame, state: RawState, index: int) -> Frame:
        """Take one frame again."""
        key = np.uint64(state.stream.spawn("frame", index).key)
        raw = exposed(light_on_sensor(frame, state.camera), state.sensor, key)
        return developed(raw, state.camera, denoise=state.sensor)
