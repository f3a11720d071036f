"""Focus on the near part of the scene."""

from __future__ import annotations

from .defocus_3d import LARGEST, Defocus3d, ThinLens


class NearFocus(Defocus3d):
    """Focuses both frames on the near part of the scene with a thin lens: the background is blurred.

    The focus is at the depth that a tenth of frame 1's pixels are nearer than. A severity is the radius in pixels of
    the disk of a point at the depth that a tenth are farther than; at other depths Z the radius goes with |Z - F| / Z,
    up to twice that. The radii are those of defocus_blur.
    """

    name = "near_focus"
    family = "depth"
    paper_severities = (3.0, 4.0, 6.0, 8.0, 10.0)

    def lens(self, radius: float, near: float, far: float) -> ThinLens:
        """Focused on `near`; blurs `far` by `radius`."""
        return ThinLens(near, radius * far / (far - near) if far > near else 0.0, LARGEST * radius)
