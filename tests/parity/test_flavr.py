"""FLAVR matches the outputs of the original implementation for every number of intermediate frames."""

import pytest

pytest.importorskip("torch", reason="needs the torch extra")

from robustflow.data.video.flavr import FLAVR

pytestmark = [pytest.mark.parity, pytest.mark.torch]
PACK = "flavr"
TOLERANCE = 2e-5
"""Tolerance for values in 0..1, from the pack's README."""


def compare(pack, case, expected, n_outputs):
    """Compare the intermediate frames, and return the encoder's feature maps."""
    net = pack.fill(FLAVR(n_outputs), f"keys_nout{n_outputs}.json")
    maps = []
    net.encoder.register_forward_hook(lambda module, clip, output: maps.extend(output))
    between = net([pack.image(f"{case}_im{i}") / 255 for i in range(4)])
    assert len(between) == n_outputs
    for i, frame in enumerate(between):
        wanted = expected[f"out{i}"]
        step = frame.shape[2] // wanted.shape[2]  # some cases only store every second row and column
        pack.check_within(f"{case} out{i} of {n_outputs}", frame[:, :, ::step, ::step], wanted, TOLERANCE)
    return maps


def test_three_interpolated_frames_equal_the_original(pack, case):
    expected = pack.expected(case)
    maps = compare(pack, case, expected, 3)
    pack.check_within(f"{case} enc_x1", maps[1][:, :2], expected["enc_x1_ch0to1"], TOLERANCE)
    pack.check_within(f"{case} enc_x4", maps[4][:, :8], expected["enc_x4_ch0to7"], TOLERANCE)


@pytest.mark.expected("_nout1")
def test_one_interpolated_frame_equals_the_original(pack, case):
    compare(pack, case, pack.expected(case, "_nout1"), 1)


def test_checkpoint_keys_for_seven_frames_equal_the_original(pack):
    net = pack.fill(FLAVR(7), "keys_nout7.json")
    assert len(net([pack.image("a_im0")[:, :, :16, :24] / 255] * 4)) == 7


@pytest.mark.expected("_nout7")
def test_seven_interpolated_frames_equal_the_original(pack, case):
    compare(pack, case, pack.expected(case, "_nout7"), 7)
