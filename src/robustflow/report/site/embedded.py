"""Slider that shows the embedded pair, for pages whose runs have no pictures; drawn once and cached per user."""

from __future__ import annotations

import json
import warnings
from dataclasses import asdict

from pydantic import TypeAdapter, ValidationError

from ...atomic import make_folder, write_json
from ...benchmarks.demo import DEMO_CLASSES
from ...cache import cache_folder
from ...datasets import load_dataset
from ...digest import digest_of_bytes, digest_of_value
from ...errors import AssetError, DataError
from ...runs.staleness import code_digest
from ...sealed import sealed, unsealed
from ...severity import SEVERITIES
from ..gallery.page import example_slider
from ..gallery.pictures import gallery
from ..slider import Slider

_KEY = "motorcycle"
_TITLE = "Middlebury 2014, Motorcycle"
_PICTURE = "data:image/jpeg;base64,"
_LARGEST = 2**24


def embedded_slider() -> Slider | None:
    """Return a slider that shows the embedded pair under every image-pair corruption, with the frost variant that needs
    no download. Return None, with a warning, if scikit-image does not include the pair. Cached pictures from a
    different version of this package, or of different frames, are redrawn."""
    try:
        sample = load_dataset(_KEY, None).load(_KEY)
    except AssetError as error:
        warnings.warn(f"no example pictures: {error}", stacklevel=3)
        return None
    frames = (digest_of_bytes(frame.tobytes()) for frame in sample.frames)
    source = digest_of_value([code_digest(), *frames], size=16)
    slider = _read(source)
    if slider is None:
        slider = example_slider(sample.frames[0], gallery(sample, SEVERITIES, classes=DEMO_CLASSES), _TITLE)
        _write(slider, source)
    return slider


def _read(source: str) -> Slider | None:
    path = cache_folder("gallery") / f"{_KEY}.json"
    try:
        if not path.is_file() or path.stat().st_size > _LARGEST:
            return None
        content = unsealed(path.read_bytes())
        document = {} if content is None else json.loads(content)
        if document.get("source") != source:
            return None
        slider = TypeAdapter(Slider).validate_python(document["slider"])
    except (OSError, ValueError, KeyError, TypeError, RecursionError, ValidationError):
        return None
    shots = (shot for _, shots in slider.corruptions for shot in shots)
    pictures = [*slider.clean, *(picture for shot in shots for picture in shot.pictures)]
    return slider if all(picture.startswith(_PICTURE) for picture in pictures) else None


def _write(slider: Slider, source: str) -> None:
    folder = cache_folder("gallery")
    try:
        make_folder(folder)
        write_json(folder / f"{_KEY}.json", sealed({"source": source, "slider": asdict(slider)}))
    except DataError:
        pass  # the cache is not writable, so the slider is redrawn next time
