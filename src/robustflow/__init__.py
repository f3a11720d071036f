"""RobustFlow: measure how robust optical-flow models are to image corruptions.

>>> import robustflow as rf
>>> model = rf.load_model("dis")
"""

from importlib import import_module

from .version import VERSION

TYPE_CHECKING = False  # with `python -m robustflow`, nothing may be imported before __main__ corrects the path
if TYPE_CHECKING:
    from typing import Any

    from . import attacks, corruptions, datasets, metrics, models, testing
    from .api import Result, evaluate, load_run
    from .attacks import Attacked, attack, list_attacks
    from .benchmarks import Benchmark
    from .corruptions import Corruption, corrupt, corrupt_clip, list_corruptions
    from .datasets import load_dataset
    from .errors import RobustFlowError
    from .flowio import read_flow, write_flow
    from .models import list_models, load_model
    from .models.torch.user_model import TorchModel
    from .report.comparison import Comparison, compare
    from .sample import Camera, Sample, SceneDepth

__version__ = VERSION

_MODULES = ("attacks", "corruptions", "datasets", "metrics", "models", "testing")

_HOMES = {
    "Attacked": "attacks",
    "attack": "attacks",
    "list_attacks": "attacks",
    "Benchmark": "benchmarks",
    "Corruption": "corruptions",
    "list_corruptions": "corruptions",
    "list_models": "models",
    "Comparison": "report.comparison",
    "compare": "report.comparison",
    "load_run": "api",
    "corrupt": "corruptions",
    "corrupt_clip": "corruptions",
    "load_dataset": "datasets",
    "RobustFlowError": "errors",
    "read_flow": "flowio",
    "write_flow": "flowio",
    "load_model": "models",
    "TorchModel": "models.torch.user_model",
    "evaluate": "api",
    "Result": "api",
    "Camera": "sample",
    "Sample": "sample",
    "SceneDepth": "sample",
}

__all__ = [
    "Attacked",
    "Benchmark",
    "Camera",
    "Comparison",
    "Corruption",
    "Result",
    "RobustFlowError",
    "Sample",
    "SceneDepth",
    "TorchModel",
    "attack",
    "attacks",
    "compare",
    "corrupt",
    "corrupt_clip",
    "corruptions",
    "datasets",
    "evaluate",
    "list_attacks",
    "list_corruptions",
    "list_models",
    "load_dataset",
    "load_model",
    "load_run",
    "metrics",
    "models",
    "read_flow",
    "testing",
    "write_flow",
]


def __dir__() -> list[str]:
    """Return the public names, so that tab completion lists them before first use."""
    return sorted({*__all__, "__version__", "__doc__", "__name__"})


def __getattr__(name: str) -> "Any":
    """Import a public name on first use, which keeps `import robustflow` fast."""
    if name in _MODULES:
        return import_module(f".{name}", __name__)
    if name not in _HOMES:
        raise AttributeError(f"module 'robustflow' has no attribute '{name}'")
    if name == "TorchModel":
        from .extras import require

        require("torch", "TorchModel")
    return getattr(import_module(f".{_HOMES[name]}", __name__), name)
