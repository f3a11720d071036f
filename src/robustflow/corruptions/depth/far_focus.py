"""Focus on the far part of the scene."""

from __future__ import annotations

from .defocus_3d import LARGEST, Defocus3d, ThinLens


class FarFocus(Defocus3d):
    """Focuses both frames on the far part of the scene with a thin lens: the foreground is blurred, and spreads.

    The focus is at the depth that a tenth of frame 1's pixels are farther than. A severity is the radius in pixels of
    the disk of a point at the depth that a tenth are nearer than; at other depths Z the radius goes with |Z - F| / Z,
    up to twice that. The radii are those of defocus_blur.
    """

    name = "far_focus"
    family = "depth"
    paper_severities = (3.0, 4.0, 6.0, 8.0, 10.0)

    def lens(self, radius: float, near: float, far: float) -> ThinLens:
        """Focused on `far`; blurs `near` by `radius`."""
        return ThinLens(far, radius * near / (far - near) if far > near else 0.0, LARGEST * radius)
