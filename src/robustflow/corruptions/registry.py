"""Every corruption by name, in the paper's order, without importing any of them."""

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
"""Families of the paper (Sec. 3) and their corruptions, in the order of its tables' columns."""

PAPER_ORDER: tuple[str, ...] = tuple(name for names in FAMILIES.values() for name in names)
CLIP: tuple[str, ...] = ("object_motion_blur", *FAMILIES["video"])
"""The corruptions that need the whole clip that the images come from."""
IMAGE_PAIR: tuple[str, ...] = tuple(name for name in PAPER_ORDER if name not in CLIP)
"""The corruptions that need nothing but the two images."""

CORRUPTIONS: Registry[type[Corruption]] = Registry("corruption", entry_point_group="robustflow.corruptions")

_CLASSES = {
    "jpeg_compression": "digital:JpegCompression",
    "pixelate": "digital:Pixelate",
    "contrast": "digital:Contrast",
    "saturate": "digital:Saturate",
    "high_light": "illumination:HighLight",
    "low_light": "illumination:LowLight",
    "over_exposure": "illumination:OverExposure",
    "under_exposure": "illumination:UnderExposure",
    "spatter": "weather.spatter:Spatter",
    "fog": "weather.fog:Fog",
    "frost": "weather.frost:Frost",
    "snow": "weather.snow:Snow",
    "gaussian_noise": "noise:GaussianNoise",
    "shot_noise": "noise:ShotNoise",
    "impulse_noise": "noise:ImpulseNoise",
    "gaussian_blur": "blur.gaussian:GaussianBlur",
    "defocus_blur": "blur.defocus:DefocusBlur",
    "glass_blur": "blur.glass:GlassBlur",
    "camera_motion_blur": "blur.camera_motion:CameraMotionBlur",
    "object_motion_blur": "clip:ObjectMotionBlur",
    "psf_blur": "blur.psf:PsfBlur",
    "h264_crf": "clip:H264Crf",
    "h264_abr": "clip:H264Abr",
    "bit_error": "clip:BitError",
    "elastic_transform": "blur.elastic:ElasticTransform",
}
SHIPPED: tuple[str, ...] = tuple(_CLASSES)
"""The corruptions of this package; installed packages add others."""

for _name, _target in _CLASSES.items():
    CORRUPTIONS.add(_name, f"robustflow.corruptions.{_target}")
