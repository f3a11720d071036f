"""HTML pages: a report of runs and the leaderboard, each in one self-contained file."""

from __future__ import annotations

from .content import Content, run_content, whole_content
from .page import render_site

__all__ = ["Content", "render_site", "run_content", "whole_content"]
