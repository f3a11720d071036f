"""Defocus with the focus on the near part of the scene."""

from __future__ import annotations

from .defocus_3d import LARGEST, Defocus3d, ThinLens


class NearFocus(Defocus3d):
    """Focuses both frames on the near part of the scene, which blurs the background."""

    name = "near_focus"
    family = "depth"
    paper_severities = (3.0, 4.0, 6.0, 8.0, 10.0)

    def lens(self, radius: float, near: float, far: float) -> ThinLens:
        """Return a lens focused at depth `near` that blurs depth `far` by `radius` pixels."""
        return ThinLens(near, radius * far / (far - near) if far > near else 0.0, LARGEST * radius)
