"""Dataset readers: one per dataset, each for the layout in which the dataset is distributed."""

from .dataset import Dataset, DatasetFacts, FromClips, PreCorrupted
from .registry import DATASETS, dataset_facts, load_dataset, needs_folder

__all__ = [
    "DATASETS",
    "Dataset",
    "DatasetFacts",
    "FromClips",
    "PreCorrupted",
    "dataset_facts",
    "load_dataset",
    "needs_folder",
]
