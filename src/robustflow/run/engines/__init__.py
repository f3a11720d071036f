"""Engines compute the units of a plan, in one process or in several."""

from __future__ import annotations
