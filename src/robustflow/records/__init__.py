"""Submission records: a run in one file that another machine can check. `docs/records.md` says what is in it."""

from __future__ import annotations
