"""The available pairs: the demo pair, uploaded pairs, and pairs from uploaded clips. Only the most recent uploads are
kept."""

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
"""Maximum number of stored uploads; the least recently used upload is removed first."""


class PairSource(Protocol):
    """A source of one or more pairs.

    Attributes:
        classes: corruption classes used in a run on these frames, see `Benchmark.classes`.
    """

    name: str
    pairs: int
    classes: Mapping[str, type[Corruption]]

    def sample(self, index: int) -> Sample:
        """Return pair number `index`, from 0."""

    def close(self) -> None:
        """Remove the files of the source."""


@dataclass
class OnePair:
    """A source with a single pair in memory."""

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
    """A source of pairs of adjacent frames from the video at `path`. `folder` is removed together with the
    source."""

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
    """Collection of sources by number; thread-safe.

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
        """Add a source, removing the least recently used if there are too many, and return its number."""
        with self._lock:
            number = secrets.token_hex(8)
            self._sources[number] = source
            gone = [self._sources.popitem(last=False)[1] for _ in range(len(self._sources) - self._kept)]
        for old in gone:
            old.close()
        return number

    def get(self, number: str) -> PairSource:
        """Return a source.

        Raises:
            UsageError: the source never existed, or was removed to make room.
        """
        if number == DEMO:
            return self._demo
        with self._lock:
            if number not in self._sources:
                raise UsageError(
                    f"these frames are no longer kept (only the last {self._kept} uploads are); add them again"
                )
            self._sources.move_to_end(number)
            return self._sources[number]

    def close(self) -> None:
        """Remove all sources."""
        with self._lock:
            gone, self._sources = list(self._sources.values()), OrderedDict()
        for source in gone:
            source.close()
