"""Plan what has to run, compute it and store the rows."""

from __future__ import annotations
