"""Run the command line in this process."""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from robustflow.cli.main import main


@pytest.fixture
def robustflow(monkeypatch, capsys, tmp_path):
    """Run the command line in `tmp_path`; return (exit code, stdout, stderr)."""
    monkeypatch.chdir(tmp_path)

    def call(*arguments: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["robustflow", *map(str, arguments)])
        try:
            main()
            code = 0
        except SystemExit as stop:
            code = int(stop.code or 0)
        captured = capsys.readouterr()
        return code, captured.out, captured.err

    return call


def write_frames(folder: Path, sizes=((64, 96), (64, 96))) -> list[Path]:
    """Write noise images 000.png, 001.png, ... with the given sizes (height, width); return their paths."""
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(0)
    paths = []
    for index, size in enumerate(sizes):
        paths.append(folder / f"{index:03d}.png")
        cv2.imwrite(str(paths[-1]), rng.integers(0, 255, (*size, 3)).astype(np.uint8))
    return paths
