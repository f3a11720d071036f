"""RobustFlow: measure how robust optical-flow models are to image corruptions.

>>> import robustflow as rf
>>> model = rf.load_model("dis")
"""

from importlib import import_module

from .core.version import VERSION

TYPE_CHECKING = False  # with `python -m robustflow`, nothing may be imported before __main__ corrects the path
if TYPE_CHECKING:
    from typing import Any

    from . import attacks, corruptions, metrics, models, testing
    from .api import Result, evaluate, load_run
    from .attacks import Attacked, attack, list_attacks
    from .core.errors import RobustFlowError
    from .core.types import Camera, Sample, SceneDepth
    from .corruptions import Corruption, corrupt, corrupt_clip, list_corruptions
    from .data import datasets as datasets
    from .data.benchmarks import Benchmark
    from .data.datasets import load_dataset
    from .media.flow import read_flow, write_flow
    from .models import list_models, load_model
    from .models.torch.user_model import TorchModel
    from .report.comparison import Comparison, compare

__version__ = VERSION

_MODULES = {
    "attacks": "attacks",
    "corruptions": "corruptions",
    "datasets": "data.datasets",
    "metrics": "metrics",
    "models": "models",
    "testing": "testing",
}

_HOMES = {
    "Attacked": "attacks",
    "attack": "attacks",
    "list_attacks": "attacks",
    "Benchmark": "data.benchmarks",
    "Corruption": "corruptions",
    "list_corruptions": "corruptions",
    "list_models": "models",
    "Comparison": "report.comparison",
    "compare": "report.comparison",
    "load_run": "api",
    "corrupt": "corruptions",
    "corrupt_clip": "corruptions",
    "load_dataset": "data.datasets",
    "RobustFlowError": "core.errors",
    "read_flow": "media.flow",
    "write_flow": "media.flow",
    "load_model": "models",
    "TorchModel": "models.torch.user_model",
    "evaluate": "api",
    "Result": "api",
    "Camera": "core.types",
    "Sample": "core.types",
    "SceneDepth": "core.types",
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
        return import_module(f".{_MODULES[name]}", __name__)
    if name not in _HOMES:
        raise AttributeError(f"module 'robustflow' has no attribute '{name}'")
    if name == "TorchModel":
        from .core.plugins import require

        require("torch", "TorchModel")
    return getattr(import_module(f".{_HOMES[name]}", __name__), name)
