"""A parity pack: outputs of the original implementation for weights defined by a rule."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import torch

from .weight_rule import digest, weights

REPORT: list[str] = []
"""Results of the comparisons, for the summary at the end of the test run."""


@dataclass(frozen=True)
class Pack:
    """A parity pack, stored as a folder.

    Attributes:
        folder: folder with key files, input images, expected arrays, and a README that states the tolerances.
    """

    folder: Path

    def image(self, name: str) -> torch.Tensor:
        """An RGB image, float32 (1, 3, H, W) in 0..255."""
        pixels = cv2.cvtColor(cv2.imread(str(self.folder / f"{name}.png")), cv2.COLOR_BGR2RGB)
        return torch.from_numpy(pixels).permute(2, 0, 1)[None].float()

    def frame(self, name: str) -> np.ndarray:
        """The image as a frame: RGB uint8 (H, W, 3)."""
        return cv2.cvtColor(cv2.imread(str(self.folder / f"{name}.png")), cv2.COLOR_BGR2RGB)

    def expected(self, case: str, suffix: str = "") -> dict[str, np.ndarray]:
        """The arrays of a case, by name."""
        with np.load(self.folder / f"{case}_expected{suffix}.npz") as arrays:
            return dict(arrays)

    def fill(self, net: torch.nn.Module, keys: str = "keys.json") -> torch.nn.Module:
        """Set a network's weights by the rule. Their names, shapes, dtypes and order must match the original's."""
        entries = json.loads((self.folder / keys).read_text())["entries"]
        own = net.state_dict()
        assert [(name, list(value.shape), str(value.dtype).removeprefix("torch.")) for name, value in own.items()] == [
            (entry["key"], entry["shape"], entry["dtype"]) for entry in entries
        ]
        values = weights(self.folder / keys)
        checksum = digest(values)
        stated = re.search(rf"{self.folder.name}/{re.escape(keys)} \| ([0-9a-f]{{64}})", self._overview)
        if stated:
            assert checksum == stated[1], "the weights differ from the rule's"
        REPORT.append(f"{self.folder.name}/{keys}: {len(entries)} keys match, SHA-256 of the weights {checksum}")
        net.load_state_dict({**own, **{key: torch.from_numpy(value) for key, value in values.items()}}, strict=True)
        return net.eval().requires_grad_(False)

    @property
    def floor(self) -> tuple[float, float]:
        """Maximum and mean change of the original's output when float32 noise is added to its input."""
        text = (self.folder / "README.md").read_text()
        if elsewhere := re.match(r"See (\.\./\w+/README\.md)", text):
            text = (self.folder / elsewhere[1]).read_text()
        stated = re.search(r"Floors?\b.*?max ([\d.e-]+), mean ([\d.e-]+)", text)
        assert stated, f"{self.folder.name}/README.md states no floor"
        return float(stated[1]), float(stated[2])

    def check_flow(
        self, what: str, found: torch.Tensor, expected: np.ndarray, floor: tuple[float, float] | None = None
    ) -> None:
        """Assert that the maximum error is at most max(10 floors, 0.001 px), and the mean error at most 5 floors +
        0.0001 px. Pass `floor` if the pack's floor was measured for a different number of iterations.
        """
        floor_max, floor_mean = floor or self.floor
        self._check(what, found, expected, max(10 * floor_max, 1e-3), 5 * floor_mean + 1e-4)

    def check_features(self, what: str, found: torch.Tensor, expected: np.ndarray) -> None:
        """Assert that the maximum error is at most 0.0001 of the largest expected value."""
        self._check(what, found, expected, 1e-4 * float(np.abs(expected).max()))

    def check_within(self, what: str, found: torch.Tensor, expected: np.ndarray, tolerance: float) -> None:
        """Assert that the maximum error is at most `tolerance`."""
        self._check(what, found, expected, tolerance)

    def _check(
        self, what: str, found: torch.Tensor, expected: np.ndarray, max_allowed: float, mean_allowed: float = np.inf
    ) -> None:
        found = np.asarray(found)
        assert found.shape == expected.shape, f"{what}: shape {found.shape} instead of {expected.shape}"
        difference = np.abs(found.astype(np.float64) - expected)
        line = f"{self.folder.name} {what}: max {difference.max():.1e} (up to {max_allowed:.1e}), "
        line += f"mean {difference.mean():.1e}" + (f" (up to {mean_allowed:.1e})" if np.isfinite(mean_allowed) else "")
        REPORT.append(line)
        assert difference.max() <= max_allowed, line
        assert difference.mean() <= mean_allowed, line

    @property
    def _overview(self) -> str:
        path = self.folder.parent / "README.md"
        return path.read_text() if path.is_file() else ""
