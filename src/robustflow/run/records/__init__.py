"""Submission records: a run as a single file that can be verified on a different machine. `docs/records.md` describes
its contents."""

from __future__ import annotations
