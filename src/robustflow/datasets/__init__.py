"""Where samples come from: one reader per dataset, in the layout it is distributed in."""

from .base import Dataset, FromClips, PreCorrupted
from .registry import DATASETS, load_dataset

__all__ = ["DATASETS", "Dataset", "FromClips", "PreCorrupted", "load_dataset"]
