"""All corruptions by name, in the paper's order; they are imported only when used. Order of the corruptions in
tables and figures: first the paper's, then those that exist only as files.

Results are grouped and ordered using these names; `registry` lists the corruptions that can be computed.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from typing import TYPE_CHECKING, Any

from ..core.errors import UsageError
from ..core.plugins import Registry
from .on_disk import SETS

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
    "high_light": "illumination.light:HighLight",
    "low_light": "illumination.light:LowLight",
    "over_exposure": "illumination.exposure:OverExposure",
    "under_exposure": "illumination.exposure:UnderExposure",
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
    "object_motion_blur": "clip.clip_corruptions:ObjectMotionBlur",
    "psf_blur": "blur.psf_blur:PsfBlur",
    "h264_crf": "clip.clip_corruptions:H264Crf",
    "h264_abr": "clip.clip_corruptions:H264Abr",
    "bit_error": "clip.clip_corruptions:BitError",
    "elastic_transform": "digital.elastic_transform:ElasticTransform",
    "fog_3d": "depth.fog_3d:Fog3d",
    "rain_3d": "depth.precipitation:Rain3d",
    "snow_3d": "depth.precipitation:Snow3d",
    "near_focus": "depth.defocus_3d:NearFocus",
    "far_focus": "depth.defocus_3d:FarFocus",
    "motion_blur_3d": "depth.motion_blur_3d:MotionBlur3d",
    "raw_noise": "sensor.raw_noise:RawNoise",
    "rolling_shutter": "clip.clip_corruptions:RollingShutter",
}
SHIPPED: tuple[str, ...] = tuple(_CLASSES)
"""The corruptions of this package; installed packages can add more."""

for _name, _target in _CLASSES.items():
    CORRUPTIONS.add(_name, f"robustflow.corruptions.{_target}")


MEMBERS: dict[str, tuple[str, ...]] = {
    family: (*names, *(each.local_name(own) for each in SETS for own in each.families.get(family, ())))
    for family, names in FAMILIES.items()
}
"""Corruptions by family. No benchmark contains both the paper's corruptions and corruptions from files, so they are
never averaged together.
"""

ORDER: tuple[str, ...] = (
    *(name for names in FAMILIES.values() for name in names),
    *(name for each in SETS for name in each.names),
)
_PLACE = {name: place for place, name in enumerate(ORDER)}
_FAMILY = {name: family for family, names in MEMBERS.items() for name in names}


def family_of(name: str) -> str | None:
    """Return the family of a corruption, or None for elastic_transform, stacks and user-defined corruptions.

    >>> family_of("fog"), family_of("robustspring_rain"), family_of("elastic_transform")
    ('weather', 'weather', None)
    """
    return _FAMILY.get(name)


def ordered(names: Iterable[str]) -> list[str]:
    """Return the corruptions in table order: those in `ORDER` first, then the remaining ones by name."""
    return sorted(names, key=lambda name: (_PLACE.get(name, len(_PLACE)), name))


ALL = "all"
"""In a list of names, selects all corruptions of the benchmark."""


def with_families(given: Iterable[Any], available: Collection[str]) -> list[Any]:
    """Replace "all" and names of families with the corruptions that they contain; keep everything else.

    >>> with_families(["noise", "fog:2+snow"], ["fog", "shot_noise", "impulse_noise"])
    ['shot_noise', 'impulse_noise', 'fog:2+snow']
    >>> with_families(["sensor"], ["fog"])
    ['raw_noise']
    """
    chosen: list[Any] = []
    for name in given:
        family = None if not isinstance(name, str) or name in CORRUPTIONS else MEMBERS.get(name) or FURTHER.get(name)
        members = available if name == ALL else family
        if members is None:
            chosen.append(name)
            continue
        fitting = [one for one in members if one in available or (name in ("depth", "sensor") and one not in CLIP)]
        if not fitting:
            raise UsageError(
                f"no corruption of the family '{name}' applies to these data; choose from {', '.join(available)}"
            )
        chosen += fitting
    return list(dict.fromkeys(chosen))
