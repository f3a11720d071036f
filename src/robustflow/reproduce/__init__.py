"""Reproduce the paper's tables and figures: which of its models can run here, and our values beside the published
ones."""

from __future__ import annotations
