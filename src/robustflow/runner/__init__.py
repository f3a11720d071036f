"""Plan what has to run, compute it, keep the rows."""

from __future__ import annotations
