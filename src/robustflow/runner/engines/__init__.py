"""Engines: the same plan and the same worker, in one process or in many."""

from __future__ import annotations
