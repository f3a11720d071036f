"""Without their extras the modules that need them are not collected for doctests; their tests skip, with a reason."""

from importlib.util import find_spec

collect_ignore_glob: list[str] = []
if find_spec("torch") is None:
    collect_ignore_glob += [
        "src/robustflow/corruptions/torch_transform.py",
        "src/robustflow/models/blocks/*",
        "src/robustflow/models/nets/*",
        "src/robustflow/models/checkpoint.py",
        "src/robustflow/models/pt2_file.py",
        "src/robustflow/models/reproducible.py",
        "src/robustflow/models/torch_clip_model.py",
        "src/robustflow/models/torch_model.py",
        "src/robustflow/models/torchscript_file.py",
        "src/robustflow/models/weights.py",
        "src/robustflow/profiling/*",
        "src/robustflow/video/flavr.py",
        "tests/models/small_net.py",
        "tests/parity/pack.py",
        "tests/parity/samflow_case.py",
    ]
if find_spec("onnx") is None:
    collect_ignore_glob += ["tests/models/onnx_graphs.py"]
if find_spec("starlette") is None or find_spec("uvicorn") is None:
    collect_ignore_glob += [f"src/robustflow/app/{name}.py" for name in ("guard", "serve", "server", "uploads")]
