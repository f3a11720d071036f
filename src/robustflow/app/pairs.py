"""The available pairs: the demo pair, uploaded pairs, and the pairs of uploaded clips. The latest few are kept."""

from __future__ import annotations

import secrets
import shutil
import threading
from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Protocol

from ..benchmarks.demo import DEMO_CLASSES
from ..corruptions import Corruption
from ..datasets.motorcycle import Motorcycle
from ..datasets.video import Video
from ..errors import UsageError
from ..sample import Sample

DEMO = "demo"
KEPT = 4
"""Uploads held at once; the least recently used one is removed first."""


class PairSource(Protocol):
    """One or more pairs under one name.

    Attributes:
        classes: of corruptions, as in a run on these frames (`Benchmark.classes`).
    """

    name: str
    pairs: int
    classes: Mapping[str, type[Corruption]]

    def sample(self, index: int) -> Sample:
        """Pair number `index`, from 0."""

    def close(self) -> None:
        """Remove its files."""


@dataclass
class OnePair:
    """A pair in memory."""

    name: str
    held: Sample
    classes: Mapping[str, type[Corruption]] = field(default_factory=dict)
    pairs: int = 1

    def sample(self, index: int) -> Sample:
        """See `PairSource.sample`."""
        return self.held

    def close(self) -> None:
        """See `PairSource.close`."""


class UploadedClip:
    """The pairs of adjacent frames of the video at `path`, for which `folder` was made; it goes with them."""

    classes: Mapping[str, type[Corruption]] = MappingProxyType({})

    def __init__(self, name: str, path: Path, folder: Path) -> None:
        self.name = name
        self._folder = folder
        self._video = Video(path)
        self.pairs = len(self._video.keys())

    def sample(self, index: int) -> Sample:
        """See `PairSource.sample`."""
        return self._video.load(self._video.keys()[index])

    def close(self) -> None:
        """See `PairSource.close`."""
        shutil.rmtree(self._folder, ignore_errors=True)


class SourceStore:
    """Sources by number; safe to use from several threads.

    >>> sources = SourceStore()
    >>> sources.get("demo").name
    'Motorcycle (Middlebury 2014)'
    """

    def __init__(self, kept: int = KEPT) -> None:
        demo = Motorcycle()
        pair = demo.load(demo.keys()[0])
        self._demo = OnePair("Motorcycle (Middlebury 2014)", replace(pair, depth=demo.depth(pair)), DEMO_CLASSES)
        self._kept = kept
        self._sources: OrderedDict[str, PairSource] = OrderedDict()
        self._lock = threading.Lock()

    def add(self, source: PairSource) -> str:
        """Add a source, removing the oldest if there are too many; returns its number."""
        with self._lock:
            number = secrets.token_hex(8)
            self._sources[number] = source
            gone = [self._sources.popitem(last=False)[1] for _ in range(len(self._sources) - self._kept)]
        for old in gone:
            old.close()
        return number

    def get(self, number: str) -> PairSource:
        """A source.

        Raises:
            UsageError: it never existed, or was removed to make room.
        """
        if number == DEMO:
            return self._demo
        with self._lock:
            if number not in self._sources:
                raise UsageError(f"these frames are no longer kept (the last {self._kept} uploads are); add them again")
            self._sources.move_to_end(number)
            return self._sources[number]

    def close(self) -> None:
        """Remove everything."""
        with self._lock:
            gone, self._sources = list(self._sources.values()), OrderedDict()
        for source in gone:
            source.close()
