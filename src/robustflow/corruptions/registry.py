"""All corruptions by name, in the paper's order; they are imported only when used."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..registry import Registry

if TYPE_CHECKING:
    from .base import Corruption

FAMILIES: dict[str, tuple[str, ...]] = {
    "digital": ("jpeg_compression", "pixelate", "contrast", "saturate"),
    "illumination": ("high_light", "low_light", "over_exposure", "under_exposure"),
    "weather": ("spatter", "fog", "frost", "snow"),
    "noise": ("gaussian_noise", "shot_noise", "impulse_noise"),
    "blur": (
        "gaussian_blur",
        "defocus_blur",
        "glass_blur",
        "camera_motion_blur",
        "object_motion_blur",
        "psf_blur",
    ),
    "video": ("h264_crf", "h264_abr", "bit_error"),
}
"""The paper's families (Sec. 3) and their corruptions, in the column order of its tables."""

PAPER_ORDER: tuple[str, ...] = tuple(name for names in FAMILIES.values() for name in names)
BETWEEN_FRAMES: tuple[str, ...] = ("object_motion_blur", "rolling_shutter")
"""Corruptions that require the frames between the two frames of a pair."""
CLIP: tuple[str, ...] = (*BETWEEN_FRAMES, *FAMILIES["video"])
"""Corruptions that require the entire clip from which the pair was taken."""
IMAGE_PAIR: tuple[str, ...] = tuple(name for name in PAPER_ORDER if name not in CLIP)
"""Corruptions that require only the two frames."""

FURTHER: dict[str, tuple[str, ...]] = {
    "digital": ("elastic_transform",),
    "depth": ("fog_3d", "rain_3d", "snow_3d", "near_focus", "far_focus", "motion_blur_3d"),
    "sensor": ("raw_noise", "rolling_shutter"),
}
"""Corruptions excluded from the paper's means and family means; those in "depth" require the depth of the scene."""

CORRUPTIONS: Registry[type[Corruption]] = Registry("corruption", entry_point_group="robustflow.corruptions")

_CLASSES = {
    "jpeg_compression": "digital.jpeg_compression:JpegCompression",
    "pixelate": "digital.pixelate:Pixelate",
    "contrast": "digital.contrast:Contrast",
    "saturate": "digital.saturate:Saturate",
    "high_light": "illumination.high_light:HighLight",
    "low_light": "illumination.low_light:LowLight",
    "over_exposure": "illumination.over_exposure:OverExposure",
    "under_exposure": "illumination.under_exposure:UnderExposure",
    "spatter": "weather.spatter:Spatter",
    "fog": "weather.fog:Fog",
    "frost": "weather.frost:Frost",
    "snow": "weather.snow:Snow",
    "gaussian_noise": "noise.gaussian_noise:GaussianNoise",
    "shot_noise": "noise.shot_noise:ShotNoise",
    "impulse_noise": "noise.impulse_noise:ImpulseNoise",
    "gaussian_blur": "blur.gaussian_blur:GaussianBlur",
    "defocus_blur": "blur.defocus_blur:DefocusBlur",
    "glass_blur": "blur.glass_blur:GlassBlur",
    "camera_motion_blur": "blur.camera_motion_blur:CameraMotionBlur",
    "object_motion_blur": "clip.object_motion_blur:ObjectMotionBlur",
    "psf_blur": "blur.psf_blur:PsfBlur",
    "h264_crf": "clip.h264_crf:H264Crf",
    "h264_abr": "clip.h264_abr:H264Abr",
    "bit_error": "clip.bit_error:BitError",
    "elastic_transform": "digital.elastic_transform:ElasticTransform",
    "fog_3d": "depth.fog_3d:Fog3d",
    "rain_3d": "depth.rain_3d:Rain3d",
    "snow_3d": "depth.snow_3d:Snow3d",
    "near_focus": "depth.near_focus:NearFocus",
    "far_focus": "depth.far_focus:FarFocus",
    "motion_blur_3d": "depth.motion_blur_3d:MotionBlur3d",
    "raw_noise": "sensor.raw_noise:RawNoise",
    "rolling_shutter": "clip.rolling_shutter:RollingShutter",
}
SHIPPED: tuple[str, ...] = tuple(_CLASSES)
"""The corruptions of this package; installed packages can add more."""

for _name, _target in _CLASSES.items():
    CORRUPTIONS.add(_name, f"robustflow.corruptions.{_target}")
