"""Adapted multi-frame models return the same bits as ptlflow itself, anywhere in a sequence and in any order."""

import contextlib
import io
from functools import cache

import cv2
import numpy as np
import pytest

from robustflow import load_model
from robustflow.core.errors import UsageError
from robustflow.models import ClipModel, FlowModel
from robustflow.models.protocols import place_of_pair
from robustflow.models.ptlflow.loaders import CLIPS

from ...refusals import refusal

NAMES = (
    "videoflow_mof",
    "memflow",
    "streamflow",
    *(pytest.param(name, marks=pytest.mark.slow) for name in ("videoflow_bof", "memflow_t", "memfof", "starflow")),
)
LENGTH = 7


@cache
def adapter(name):
    options = {} if name.endswith("starflow") else {"iterations": 2}
    if name.startswith("memflow"):
        options["before"] = 3
    model = load_model(name, checkpoint="random", device="cpu", **options)
    for key, value in model.net.state_dict().items():
        if key.endswith("aggregator.gamma"):
            value.fill_(1)  # gamma is 0 in new networks, which disables their memory
    return model


@cache
def sequence(side):
    rng = np.random.default_rng(0)
    ground, square = (
        cv2.resize(rng.integers(0, 256, (n // 8, n // 8, 3)).astype(np.uint8), (n, n)) for n in (2 * side, side // 2)
    )
    frames = []
    for time in range(LENGTH):
        frame = ground[:side, 2 * time : side + 2 * time].copy()
        frame[8 + time : 8 + time + side // 2, 5 * time : 5 * time + side // 2] = square
        frames.append(np.ascontiguousarray(frame))
    return frames


def side_of(name):
    return 256 if name == "memfof" else 128  # MEMFOF's correlation pyramid needs 16 x 16 features


def ask(name, first):
    """The clip that a run requests for the pair starting at frame `first` of the sequence."""
    model, frames = adapter(name), sequence(side_of(name))
    offsets = model.window.offsets(range(-first, LENGTH - first))
    return model.predict_clip(tuple(frames[first + offset] for offset in offsets), place_of_pair(offsets))


def images_of(frames):
    import torch

    stacked = np.stack([frame[..., ::-1] for frame in frames])
    return torch.from_numpy(stacked).permute(0, 3, 1, 2)[None].float() / 255


def fresh(ptlflow, name):
    """The library's model, built and configured with the library's own functions, with the adapter's weights."""
    model = adapter(name)
    with contextlib.redirect_stdout(io.StringIO()):
        reference = ptlflow.get_model_reference(name)
        options = {"backbone_weights": None} if name == "memfof" else {}
        if "starflow" not in name:
            options["iters" if name in ("streamflow", "memfof") else "decoder_depth"] = 2
        net = reference(**options)
    net.load_state_dict(model.net.model.state_dict())
    return net.eval()


def from_the_library(net, name, first):
    import torch

    frames = sequence(side_of(name))
    with torch.inference_mode():
        if name.startswith("memflow"):
            start = max(0, first - 3)
            for place in range(start, first + 1):
                meta = {"is_seq_start": place == start, "is_seq_end": place == first}
                flows = net({"images": images_of(frames[place : place + 2]), "meta": meta})["flows"]
            wanted = flows[0, 0]
        elif name == "streamflow":
            start = min(max(first - 2, 0), LENGTH - 4)
            wanted = net({"images": images_of(frames[start : start + 4])})["flows"][0, first - start]
        elif name == "starflow":
            wanted = net({"images": images_of(frames[max(0, first - 2) : first + 2])})["flows"][0, -1]
        elif name == "videoflow_mof":
            wanted = videoflow(net, [frames[0], *frames], first + 1)
        else:
            wanted = net({"images": images_of([frames[max(0, first - 1)], *frames[first : first + 2]])})["flows"][0, 0]
    return wanted.permute(1, 2, 0).numpy()


def videoflow(net, sequence, first):
    """Evaluate as the authors do: with five frames of the sequence, whose first frame is repeated, and the requested
    frame as close to the centre as possible. The library returns only the middle flow, so the flows are read before it
    selects one.
    """
    start = min(max(first - 2, 0), len(sequence) - 5)
    upsampled = []
    upsample = net.upsample_flow
    net.upsample_flow = lambda flow, mask: upsampled.append(upsample(flow, mask)) or upsampled[-1]
    try:
        net({"images": images_of(sequence[start : start + 5])})
    finally:
        net.upsample_flow = upsample
    forward, _ = upsampled[-2:]
    return forward[first - start - 1]


@pytest.mark.torch
@pytest.mark.parametrize("name", NAMES)
def test_flow_anywhere_in_a_sequence_is_bit_equal_to_that_of_the_library(library, capsys, name):
    net = fresh(library, name)
    flows = {}
    for first in (3, 0, LENGTH - 2, 1):
        flows[first] = ask(name, first)
        assert flows[first].shape == (side_of(name), side_of(name), 2)
        assert np.abs(flows[first]).max() > 0
        np.testing.assert_array_equal(flows[first], from_the_library(net, name, first), err_msg=f"pair {first}")
    np.testing.assert_array_equal(ask(name, 3), flows[3], err_msg="asked again")
    assert capsys.readouterr().out == ""


@pytest.mark.torch
@pytest.mark.parametrize("name", ["memflow", pytest.param("starflow", marks=pytest.mark.slow)])
def test_clip_models_that_accept_two_frames_equal_the_library(library, name):
    model = adapter(name)
    assert isinstance(model, FlowModel)
    frames = sequence(128)
    np.testing.assert_array_equal(model.predict(frames[0], frames[1]), ask(name, 0))
    assert (ask(name, 3) != model.predict(frames[3], frames[4])).any(), "the frames before the pair are not used"


@pytest.mark.torch
@pytest.mark.parametrize("name", ["videoflow_mof", "streamflow"])
def test_clip_models_that_need_more_frames_use_the_whole_short_sequence(library, name):
    from robustflow.models.profile import network_of

    model = adapter(name)
    assert isinstance(model, ClipModel)
    assert not isinstance(model, FlowModel)
    frames = sequence(128)
    short = model.predict_clip(tuple(frames[:3]), 1)
    assert np.isfinite(short).all(), "a sequence shorter than the window is passed in full"
    refusal(lambda: model.predict_clip(tuple(frames[:3]), 2), UsageError, "index")
    for frame, culprit in ((frames[2][:-8], "(120, 128)"), (frames[2] / 255, "float64 (128, 128, 3)")):
        refusal(lambda frame=frame: model.predict_clip((*frames[:2], frame), 1), UsageError, culprit)
    refusal(lambda: network_of(model), UsageError, name)
    refusal(lambda: load_model(name, checkpoint="random", before=2), UsageError, "before")


@pytest.mark.torch
def test_memory_networks_get_the_declared_number_of_frames(library):
    assert load_model("memflow", checkpoint="random").window == CLIPS["memflow"].window
    assert load_model("memflow", checkpoint="random", before=2).window.before == 2
    for wrong in (0, 1.5):
        refusal(lambda wrong=wrong: load_model("memflow", checkpoint="random", before=wrong), UsageError, "before")
