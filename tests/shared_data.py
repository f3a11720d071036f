"""Locate the shared real data: `ROBUSTFLOW_SHARED`, else `../shared` next to the checkout."""

import os
from pathlib import Path

import pytest

_CHECKOUT = Path(__file__).resolve().parent.parent


def shared_root() -> Path:
    """The folder itself, which may not exist."""
    return Path(os.environ.get("ROBUSTFLOW_SHARED") or _CHECKOUT.parent / "shared")


def shared_folder(*parts: str) -> Path:
    """A path in the shared data; if it is missing, skip with a message that explains how to supply it."""
    path = shared_root().joinpath(*parts)
    if not path.exists():
        pytest.skip(f"shared data '{'/'.join(parts)}' not found; set ROBUSTFLOW_SHARED to the folder that contains it")
    return path
