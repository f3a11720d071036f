"""Reports: read rows, never models or images."""

from __future__ import annotations
