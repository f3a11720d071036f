"""Without their extras the modules that need them are not collected for doctests; their tests skip, with a reason."""

from importlib.util import find_spec

collect_ignore_glob: list[str] = []
if find_spec("torch") is None:
    collect_ignore_glob += [
        "src/robustflow/corruptions/transforms/torch_transform.py",
        "src/robustflow/models/own/blocks/*",
        "src/robustflow/models/own/nets/*",
        "src/robustflow/models/exported/net.py",
        "src/robustflow/models/exported/pt2_file.py",
        "src/robustflow/models/exported/torchscript_file.py",
        "src/robustflow/models/ptlflow/clip_net.py",
        "src/robustflow/models/ptlflow/net.py",
        "src/robustflow/models/torch/checkpoint.py",
        "src/robustflow/models/torch/clip_model.py",
        "src/robustflow/models/torch/model.py",
        "src/robustflow/models/torch/raft_net.py",
        "src/robustflow/models/torch/reproducible.py",
        "src/robustflow/models/torch/weights.py",
        "src/robustflow/profiling/*",
        "src/robustflow/video/flavr.py",
        "tests/models/torch/small_net.py",
        "tests/parity/pack.py",
        "tests/parity/samflow_case.py",
    ]
if find_spec("onnx") is None:
    collect_ignore_glob += ["tests/models/exported/onnx_graphs.py"]
if find_spec("starlette") is None or find_spec("uvicorn") is None:
    collect_ignore_glob += [f"src/robustflow/app/{name}.py" for name in ("guard", "serve", "server", "uploads")]
