"""Picture slider for pages: a clean picture next to corrupted ones, selected by corruption, severity and frame."""

from __future__ import annotations

from .slider import Shot, Slider, make_slider, script, slider_markup, style

__all__ = ["Shot", "Slider", "make_slider", "script", "slider_markup", "style"]
