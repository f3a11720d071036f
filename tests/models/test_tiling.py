"""Test the positions and blending of tiles, and the frames that the model receives."""

import json

import numpy as np
import pytest

from robustflow.core.errors import ModelError, UsageError
from robustflow.models import load_model
from robustflow.models.tiling import SIGMA, TiledModel, tile_origins, tile_weights, tiled

from ..refusals import refusal


class Counting:
    """Returns the constant flow i for the i-th tile, starting at 1."""

    def __init__(self):
        self.tiles = []

    def predict(self, frame1, frame2):
        self.tiles.append((frame1, frame2))
        return np.full((*frame1.shape[:2], 2), len(self.tiles), np.float32)


def position_frames(height, width):
    """Frames whose pixels encode their positions."""
    y, x = np.mgrid[:height, :width]
    frame1 = np.stack((y % 256, x % 256, x // 256), axis=-1).astype(np.uint8)
    return frame1, 255 - frame1


def test_tile_origins_and_blending_equal_the_authors_code(shared):
    cases = json.loads(shared("parity/samflow_t/tiling.json").read_text())
    assert cases
    for case in cases.values():
        (height, width), (tile_height, tile_width) = case["padded_size"], case["tile"]
        origins = [[y, x] for y in tile_origins(height, tile_height) for x in tile_origins(width, tile_width)]
        assert origins == case["unique_origins_yx"]
        model = Counting()
        flow = TiledModel(model, f"{tile_height}x{tile_width}").predict(*position_frames(height, width))
        assert flow.shape == (height, width, 2)
        assert len(model.tiles) == len(origins)
        blend = case["blend_of_constants_1_2_.."]
        np.testing.assert_allclose(flow[blend["row"], ::16, 0], blend["x_every_16"], atol=1e-6)


def test_a_tile_is_the_frames_pixels_and_black_beyond_them():
    model = Counting()
    frames = position_frames(60, 200)
    TiledModel(model, "64x96").predict(*frames)
    assert [len(model.tiles), model.tiles[0][0].shape] == [3, (64, 96, 3)]
    for i, x in enumerate(tile_origins(200, 96)):
        for tile, frame in zip(model.tiles[i], frames, strict=True):
            np.testing.assert_array_equal(tile[:60], frame[:, x : x + 96])
            assert not tile[60:].any()


def test_blend_is_the_weighted_mean():
    """The blended flow equals a loop over pixels with weights that are scaled to a maximum of 1."""
    flows = np.random.default_rng(0).normal(0, 5, (4, 40, 48, 2)).astype(np.float32)

    class Stored:
        def __init__(self):
            self.next = iter(flows)

        def predict(self, frame1, frame2):
            return next(self.next)

    found = TiledModel(Stored(), "40x48").predict(*position_frames(52, 70))
    origins = [(y, x) for y in (0, 12) for x in (0, 22)]
    for y, x in ((0, 0), (5, 69), (13, 30), (26, 35), (39, 47), (51, 69)):
        inside = [
            (i, y - top, x - left) for i, (top, left) in enumerate(origins) if 0 <= y - top < 40 and 0 <= x - left < 48
        ]
        exponents = [-((row / 40 - 0.5) ** 2 + (column / 48 - 0.5) ** 2) / (2 * SIGMA**2) for _, row, column in inside]
        weights = [np.exp(exponent - max(exponents)) for exponent in exponents]
        mean = sum(w * flows[i, row, column].astype(float) for w, (i, row, column) in zip(weights, inside, strict=True))
        np.testing.assert_allclose(found[y, x], mean / sum(weights), rtol=1e-6)


def test_flow_is_exact_where_only_a_tile_corner_covers():
    class Ramp:
        def predict(self, frame1, frame2):
            return np.random.default_rng(1).normal(0, 100, (*frame1.shape[:2], 2)).astype(np.float32)

    frame = np.zeros((432, 960, 3), np.uint8)
    alone = Ramp().predict(frame, frame)
    np.testing.assert_allclose(TiledModel(Ramp(), "432x960").predict(frame, frame), alone, rtol=1e-6)
    weights = tile_weights(432, 960)
    assert weights.min() > np.finfo(np.float64).tiny
    assert (weights.astype(np.float32) < np.finfo(np.float32).tiny).any()  # float32 would underflow


def test_batched_pairs_of_any_size_equal_single_ones():
    class Batched(Counting):
        def predict(self, frame1, frame2):
            return np.repeat(frame1.astype(np.float32).mean(-1, keepdims=True), 2, axis=-1)

        def predict_batch(self, frames1, frames2):
            self.tiles.append(len(frames1))
            return [self.predict(frame1, frame2) for frame1, frame2 in zip(frames1, frames2, strict=True)]

    model = Batched()
    pairs = [position_frames(*size) for size in ((64, 96), (70, 300), (20, 30))]
    together = TiledModel(model, "64x96").predict_batch(*zip(*pairs, strict=True))
    assert model.tiles == [3, 1, 1, 1, 1, 1, 1, 1]
    for pair, flow in zip(pairs, together, strict=True):
        np.testing.assert_array_equal(TiledModel(model, "64x96").predict(*pair), flow)


@pytest.mark.parametrize("shape", [(2,), (64, 96, 1), (1, 1, 2)])
def test_answer_of_a_different_shape_than_the_tile_is_refused(shape):
    class Broadcasts:
        def predict(self, frame1, frame2):
            return np.ones(shape, np.float32)

    model = TiledModel(Broadcasts(), "64x96")
    refusal(lambda: model.predict(*position_frames(64, 96)), ModelError, "a tile")
    refusal(lambda: model.predict(*np.zeros((2, 64, 96, 3))), UsageError, "float64 (64, 96, 3)")


@pytest.mark.parametrize("tile", [None, "none"])
def test_a_model_without_tiles_is_unchanged(tile):
    model = Counting()
    assert tiled(model, tile) is model
    assert isinstance(tiled(model, "64x96"), TiledModel)


def test_any_model_takes_the_option(tmp_path):
    model = load_model("dis", tile="64x96")
    assert isinstance(model, TiledModel)
    assert model.identity() == {**load_model("dis").identity(), "tile": [64, 96], "overlap": 20, "sigma": 0.05}
    frames = position_frames(64, 96)
    np.testing.assert_allclose(model.predict(*frames), load_model("dis").predict(*frames), rtol=1e-6)
    assert not isinstance(load_model("dis", tile="none"), TiledModel)
    (tmp_path / "clean").mkdir()
    refusal(lambda: load_model(str(tmp_path), tile="64x96"), UsageError, "tile")


@pytest.mark.parametrize("size", ["432", "0x0", "16x960", "large", "99960x99960"])
def test_invalid_tile_size_is_refused(size):
    with pytest.raises(UsageError):
        TiledModel(Counting(), size)
