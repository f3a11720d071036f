"""Convert trained weights to a file for distribution with the package: `python -m robustflow.training.ship`."""

from __future__ import annotations

import json
import sys
from pathlib import Path

from safetensors.torch import save

from ..atomic import write_bytes
from .checkpoint import read_progress


def ship_weights(checkpoint: Path, target: Path, command: str, commit: str) -> None:
    """Write weights as safetensors, with the settings that determine them."""
    content, about = read_progress(checkpoint)
    record = {
        "made_by": command,
        "commit": commit,
        "updates": str(about.updates),
        "training": json.dumps(about.identity, sort_keys=True),
    }
    write_bytes(target, save({key: value.contiguous() for key, value in content["model"].items()}, record))


if __name__ == "__main__":
    if len(sys.argv) != 5:
        sys.exit("usage: python -m robustflow.training.ship CHECKPOINT TARGET.safetensors 'COMMAND' COMMIT")
    ship_weights(Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3], sys.argv[4])
