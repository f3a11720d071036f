"""Reports of results as tables, figures, galleries and pages."""

from __future__ import annotations
