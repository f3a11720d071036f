"""Reproduce the paper's tables and figures: which of its models can be run here, and how our values compare with the
published ones."""

from __future__ import annotations
