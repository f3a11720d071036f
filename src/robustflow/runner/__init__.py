"""Run a benchmark: plan the units, compute them and store the rows."""

from __future__ import annotations
