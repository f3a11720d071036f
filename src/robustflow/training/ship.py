"""Write the weights of a training as the file that the package ships: `python -m robustflow.training.ship`."""

from __future__ import annotations

import json
import sys
from pathlib import Path

from safetensors.torch import save

from ..atomic import write_bytes
from .checkpoint import read_progress


def ship_weights(checkpoint: Path, target: Path, command: str, commit: str) -> None:
    """Write weights as safetensors, with what determined them.

    Args:
        checkpoint: `last.pth` of a training.
        target: to write.
        command: that made the training.
        commit: of this project's code that the training ran with.

    Raises:
        RunError, ModelError: no training there, or a damaged one.
    """
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
