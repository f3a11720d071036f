"""Reports made from result rows; nothing here loads models or images."""

from __future__ import annotations
