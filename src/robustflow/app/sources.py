"""The pairs that the page offers: the demo pair and the most recent uploads, pairs or clips."""

from __future__ import annotations

import secrets
import shutil
import threading
from collections import OrderedDict
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType

from ..core.errors import UsageError
from ..core.types import Sample
from ..corruptions import Corruption
from ..data.benchmarks.paper import DEMO_CLASSES
from ..data.datasets.folder import open_folder
from ..data.datasets.motorcycle import Motorcycle

DEMO = "demo"
KEPT = 4
"""Maximum number of stored uploads; the least recently used upload is removed first."""


@dataclass(frozen=True)
class PairSource:
    """A source of one or more pairs."""

    name: str
    pairs: int
    sample: Callable[[int], Sample]
    classes: Mapping[str, type[Corruption]] = field(default_factory=dict)
    folder: Path | None = None

    def close(self) -> None:
        """Remove the files of the source."""
        if self.folder is not None:
            shutil.rmtree(self.folder, ignore_errors=True)


def one_pair(name: str, pair: Sample, classes: Mapping[str, type[Corruption]] = MappingProxyType({})) -> PairSource:
    """Make a source of a single pair in memory."""
    return PairSource(name, 1, lambda _: pair, classes)


def clip_pairs(name: str, path: Path, folder: Path) -> PairSource:
    """Make a source of the pairs of adjacent frames in a video file inside `folder`."""
    video = open_folder(path)
    keys = video.keys()
    return PairSource(name, len(keys), lambda index: video.load(keys[index]), folder=folder)


class SourceStore:
    """Collection of sources by number; thread-safe.

    >>> sources = SourceStore()
    >>> sources.get("demo").name
    'Motorcycle (Middlebury 2014)'
    """

    def __init__(self) -> None:
        demo = Motorcycle()
        pair = demo.load(demo.keys()[0])
        self._demo = one_pair("Motorcycle (Middlebury 2014)", replace(pair, depth=demo.depth(pair)), DEMO_CLASSES)
        self._sources: OrderedDict[str, PairSource] = OrderedDict()
        self._lock = threading.Lock()

    def add(self, source: PairSource) -> str:
        """Add a source, removing the least recently used if there are too many, and return its number."""
        with self._lock:
            number = secrets.token_hex(8)
            self._sources[number] = source
            removed = [self._sources.popitem(last=False)[1] for _ in range(len(self._sources) - KEPT)]
        for old in removed:
            old.close()
        return number

    def get(self, number: str) -> PairSource:
        """Return a source."""
        if number == DEMO:
            return self._demo
        with self._lock:
            if number not in self._sources:
                raise UsageError("frames", f"only the last {KEPT} uploads are kept; add them again")
            self._sources.move_to_end(number)
            return self._sources[number]

    def close(self) -> None:
        """Remove all sources."""
        with self._lock:
            gone, self._sources = list(self._sources.values()), OrderedDict()
        for source in gone:
            source.close()
