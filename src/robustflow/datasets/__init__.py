"""Where samples come from: one reader per dataset, in the layout it is distributed in."""

from .base import Dataset, PreCorrupted

__all__ = ["Dataset", "PreCorrupted"]
