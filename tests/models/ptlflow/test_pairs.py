"""Adapted two-frame models return the same bits as ptlflow itself, print nothing, and fail with clear messages."""

import inspect
import subprocess
import sys
from collections.abc import Sequence
from functools import cache

import numpy as np
import pytest

from robustflow import load_model
from robustflow.core.errors import ModelError, UsageError
from robustflow.models import ModelRef
from robustflow.models.catalog import PTLFLOW
from robustflow.models.confidence import ConfidentModel
from robustflow.models.ptlflow.loaders import BESIDES, CONFIDENT, constructor_options
from robustflow.models.registered import MODELS

from ...refusals import refusal
from ..textures import textured_pair

PAPER = ("raft", "gma", "csflow", "skflow", "gmflownet", "craft", "flowformer", "flowformer_pp")


def test_twelve_iterations_are_the_default():
    assert {inspect.signature(MODELS.get(name)).parameters["iterations"].default for name in PAPER} == {12}


@cache
def adapter(name):
    return load_model(name, checkpoint="random", iterations=2, device="cpu")


def from_the_library(ptlflow, name, model, frames):
    """Predict with the library alone, as its users would, but with the adapter's weights."""
    import torch
    from ptlflow.utils.io_adapter import IOAdapter

    net = ptlflow.get_model(name)
    setattr(net, "decoder_depth" if name.startswith("flowformer") else "iters", 2)
    if name.startswith("flowformer"):
        net.memory_decoder.depth = 2
    net.load_state_dict(model.net.model.state_dict())
    net.eval()
    images = [np.ascontiguousarray(frame[..., ::-1]) for frame in frames]
    inputs = IOAdapter(net.output_stride, images[0].shape[:2]).prepare_inputs(images)
    with torch.no_grad():
        return net({"images": inputs["images"]})["flows"][0, 0].permute(1, 2, 0).numpy()


@pytest.mark.torch
@pytest.mark.parametrize("name", [*PAPER, "sea_raft_s", "recover_rn"])
def test_flow_is_bit_equal_to_that_of_the_library(library, capsys, name):
    """The constructors of the last two write into their defaults; they receive lists, as from the library's own
    loader, recover_rn through its base class.
    """
    frames = textured_pair(131, 137)
    model = adapter(name)
    assert model.identity()["iterations"] == 2
    flow = model.predict(*frames)
    assert capsys.readouterr().out == ""
    expected = from_the_library(library, name, model, frames)
    assert np.abs(expected).max() > 0
    np.testing.assert_array_equal(flow, expected)


@pytest.mark.torch
def test_craft_predicts_in_mixed_precision(library):
    pair = textured_pair(121, 125)
    half = load_model("craft", checkpoint="random", iterations=2, device="cpu", precision="bf16").predict(*pair)
    full = adapter("craft").predict(*pair)
    assert 0 < np.abs(full - half).mean() < 0.05 * np.abs(full).mean()


@pytest.mark.torch
@pytest.mark.parametrize(("name", "smallest"), [("raft", 121), ("gmflownet", 121), ("flowformer", 25)])
def test_frames_too_small_for_numbers_are_refused(library, name, smallest):
    model = adapter(name)
    assert np.isfinite(model.predict(*textured_pair(smallest, 160))).all()
    for size in ((smallest - 1, 160), (160, smallest - 1)):
        refusal(lambda size=size: model.predict(*textured_pair(*size)), ModelError, f"{size[0]}x{size[1]}")
    if smallest == 121:
        assert np.isnan(from_the_library(library, name, model, textured_pair(120, 160))).any()


@pytest.mark.torch
def test_identity_states_weights_and_execution(library):
    identity = adapter("flowformer").identity()
    assert identity["input"]["order"] == "bgr"
    assert (
        identity.items()
        >= {
            "name": "flowformer",
            "checkpoint": "random",
            "iterations": 2,
            "use_tile_input": False,
            "library": f"ptlflow {library.__version__}",
        }.items()
    )


@pytest.mark.torch
def test_models_of_the_library_load_by_name(library):
    frames = textured_pair(128, 160)
    model = load_model("ptlflow:raft_small", checkpoint="random", iterations=1, device="cpu")
    assert model.predict(*frames).shape == (128, 160, 2)
    assert load_model("ptlflow:raft", checkpoint="random").identity()["iterations"] == 32
    refusal(lambda: load_model("pwcnet", checkpoint="random", iterations=3), UsageError, "iterations")
    spec = ModelRef.parse("ptlflow:raft_small", (("checkpoint", "random"),))
    assert "source" not in spec.identity(model), "the library must be identified by its version instead of a file hash"


@pytest.mark.torch
def test_confidence_of_a_network_equals_that_of_the_library(library):
    import torch

    frames = textured_pair(64, 96)
    model = load_model("liteflownet3s", checkpoint="random", device="cpu")
    flow, confidence = model.predict_with_confidence(*frames)
    assert np.array_equal(flow, model.predict(*frames))
    images = torch.from_numpy(np.stack(frames)[..., ::-1].copy()).permute(0, 3, 1, 2)[None].float() / 255
    with torch.inference_mode():
        outputs = model.net.model({"images": images})
    assert np.array_equal(confidence, outputs["confs"][0, 0, 0].numpy())
    assert np.ptp(confidence) > 0
    assert not isinstance(adapter("raft"), ConfidentModel)
    refusal(lambda: model.predict_with_confidence(frames[0], frames[1][1:]), UsageError, "(63, 96)")


LAYOUTS = {
    "authors": lambda state: {f"module.{key}": value for key, value in state.items()},
    "ptlflow": lambda state: {"state_dict": state, "hyper_parameters": {"train_size": [64, 64]}},
}


@pytest.mark.torch
@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("name", ["csflow", "flowformer"])
def test_checkpoints_of_the_authors_and_of_ptlflow_load(library, tmp_path, layout, name):
    """CSFlow's keys have a prefix in ptlflow that the authors' files do not have. FlowFormer would predict in tiles if
    the stored `train_size` were applied.
    """
    import torch

    model = adapter(name)
    state = model.net.model.state_dict()
    if layout == "authors":
        state = {key.removeprefix("_model."): value for key, value in state.items()}
    torch.save(LAYOUTS[layout](state), tmp_path / "weights.pth")
    loaded = load_model(name, checkpoint=tmp_path / "weights.pth", iterations=2, device="cpu")
    frames = textured_pair(131, 137)
    np.testing.assert_array_equal(loaded.predict(*frames), model.predict(*frames))
    assert len(loaded.identity()["checkpoint"]) == 64


@pytest.mark.torch
def test_a_checkpoint_as_the_librarys_trainer_writes_it(library, tmp_path):
    """A Lightning checkpoint of a ptlflow model: in addition to the weights, it contains hyperparameters and
    the states of the loops, the optimizer and the callbacks.
    """
    import torch
    from lightning.pytorch import Trainer
    from lightning.pytorch.callbacks import ModelCheckpoint

    quiet = {"logger": False, "enable_progress_bar": False, "enable_model_summary": False, "accelerator": "cpu"}
    trainer = Trainer(max_steps=1, callbacks=[ModelCheckpoint(dirpath=tmp_path)], default_root_dir=tmp_path, **quiet)
    net = library.get_model("raft")
    net.train_size = [64, 64]
    trainer.strategy.connect(net)
    trainer.strategy.setup_optimizers = lambda trainer: None
    trainer.save_checkpoint(tmp_path / "raft.ckpt")
    content = torch.load(tmp_path / "raft.ckpt", weights_only=True)
    assert {"state_dict", "hyper_parameters", "pytorch-lightning_version", "loops", "callbacks"} <= set(content)
    loaded = load_model("raft", checkpoint=tmp_path / "raft.ckpt", iterations=1, device="cpu")
    for key, value in net.state_dict().items():
        assert torch.equal(loaded.net.model.state_dict()[key], value)
    del content["state_dict"]["fnet.conv1.weight"]
    torch.save(content, tmp_path / "less.ckpt")
    error = refusal(lambda: load_model("raft", checkpoint=tmp_path / "less.ckpt"), ModelError, tmp_path / "less.ckpt")
    assert "fnet.conv1.weight" in str(error)


@pytest.mark.torch
def test_state_of_a_memory_network_outside_its_weights_is_set(library, tmp_path):
    import torch

    path = tmp_path / "memory.ckpt"
    content = {"state_dict": load_model("memflow", checkpoint="random").net.model.state_dict()}
    torch.save(content | {"hyper_parameters": {"train_avg_length": 4000}}, path)
    model = load_model("memflow", checkpoint=path)
    assert model.net.model.train_avg_length == model.identity()["train_avg_length"] == 4000
    torch.save(content | {"hyper_parameters": {"train_avg_length": "4000"}}, path)
    refusal(lambda: load_model("memflow", checkpoint=path), ModelError, path)


@pytest.mark.torch
def test_checkpoint_of_the_library_is_chosen_by_name(library, tmp_path, monkeypatch):
    import torch

    monkeypatch.setattr(torch.hub, "get_dir", lambda: str(tmp_path))
    path = tmp_path / "checkpoints" / "raft-things-802bbcfd.ckpt"
    path.parent.mkdir()
    path.write_bytes(b"a different file")
    refusal(lambda: load_model("raft", checkpoint="things"), ModelError, path)


@pytest.mark.torch
def test_the_first_import_is_silent(library):
    """Use a separate process, because the library prints output when it is imported."""
    code = "import robustflow; robustflow.load_model('raft', checkpoint='random', device='cpu')"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == ""


@pytest.mark.torch
@pytest.mark.parametrize("checkpoint", ["random", "kitti", None])
def test_missing_optional_library_is_named_before_the_checkpoint(library, monkeypatch, checkpoint):
    splatflow = sys.modules["ptlflow.models.splatflow.splatflow"]
    monkeypatch.setattr(splatflow, "forward_warping", None)  # the value that ptlflow sets if cupy is missing
    assert "cupy" in str(refusal(lambda: load_model("splatflow", checkpoint=checkpoint), ModelError, "splatflow"))


@pytest.mark.torch
def test_missing_constructor_argument_is_reported_in_one_line(library, monkeypatch):
    reference = library.get_model_reference("raft")
    for raised in (ImportError("no\nkernel"), ValueError("b")):

        def fails(self, iters=32, error=raised):
            raise error

        monkeypatch.setattr(reference, "__init__", fails)
        refusal(lambda: load_model("raft", checkpoint="random"), ModelError, "raft")


@pytest.mark.torch
def test_prefix_of_a_name_that_has_one_meaning_is_refused(library):
    for name in ("ptlflow:dpflow", "ptlflow:memflow", "splatflov"):
        refusal(lambda name=name: load_model(name), UsageError, name)


@pytest.mark.slow
@pytest.mark.torch
def test_every_model_of_the_library_predicts_or_says_what_it_needs(library):
    names = library.get_model_names()
    assert set(BESIDES) <= set(names)
    frames = textured_pair(256, 384)  # the smallest size that all models accept
    for name in names:
        needs = BESIDES.get(name)
        known = f"{PTLFLOW}{name}" if name == "raft_small" else name
        if needs is not None:
            refusal(lambda known=known: load_model(known, checkpoint="random", device="cpu"), ModelError, known)
            continue
        model = load_model(known, checkpoint="random", device="cpu")
        assert model.identity()["name"] == known
        if hasattr(model, "predict"):
            returned: set[str] = set()
            model.net.model.register_forward_hook(lambda net, given, outputs, known=returned: known.update(outputs))
            flow = model.predict(*frames)
            assert ("confs" in returned) == isinstance(model, ConfidentModel) == (name in CONFIDENT), name
        else:
            offsets = model.window.offsets(range(-5, 7))
            flow = model.predict_clip([frames[offset % 2] for offset in offsets], offsets.index(0))
        assert flow.shape == (256, 384, 2)
        assert np.isfinite(flow).all(), name


WIDTHS = (64, 96)


class Net:
    def __init__(self, widths=WIDTHS, strides=WIDTHS, iters=32, backbone_weights="fetched", levels=3): ...

    __init__.__annotations__ = {"widths": Sequence[int], "strides": tuple[int, int]}


class Smaller(Net):
    def __init__(self, levels=2, **kwargs):
        super().__init__(levels=levels, **kwargs)


class Pyramid(Net):
    def __init__(self, iters=(4, 6)): ...


@pytest.mark.parametrize("net", [Net, Smaller])
def test_sequence_options_of_all_base_classes_become_lists(net):
    options, rounds = constructor_options("net", net, None)
    assert options == {"widths": [64, 96], "backbone_weights": None, "iters": 32}
    assert rounds == 32
    options["widths"][0] = 1
    assert constructor_options("net", net, 5) == ({"widths": [64, 96], "backbone_weights": None, "iters": 5}, 5)
    assert WIDTHS == (64, 96)


def test_arguments_of_a_base_class_are_hidden_by_a_closed_constructor():
    assert constructor_options("pyramid", Pyramid, None) == ({}, None)
    refusal(lambda: constructor_options("pyramid", Pyramid, 3), UsageError, "iterations")
