"""Defocus with the focus on the far part of the scene."""

from __future__ import annotations

from .defocus_3d import LARGEST, Defocus3d, ThinLens


class FarFocus(Defocus3d):
    """Focuses both frames on the far part of the scene, so the blurred foreground spreads beyond its outlines."""

    name = "far_focus"
    family = "depth"
    paper_severities = (3.0, 4.0, 6.0, 8.0, 10.0)

    def lens(self, radius: float, near: float, far: float) -> ThinLens:
        """Return a lens focused at depth `far` that blurs depth `near` by `radius` pixels."""
        return ThinLens(far, radius * near / (far - near) if far > near else 0.0, LARGEST * radius)
