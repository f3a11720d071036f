"""Submission records: a run as one file that another machine can check. `docs/records.md` describes its contents."""

from __future__ import annotations
