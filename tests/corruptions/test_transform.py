"""The random transform of arrays and tensors: formats, keys, pickling, processes and workers."""

import multiprocessing
import os
import pickle
import subprocess
import sys
import textwrap

import cv2
import numpy as np
import pytest

from robustflow.core.errors import UsageError
from robustflow.core.rng import Rng
from robustflow.corruptions import IMAGE_PAIR, load_corruption
from robustflow.corruptions.scale import calibrated_levels
from robustflow.corruptions.transform import CorruptionTransform

from ..refusals import refusal
from .pictures import picture


@pytest.mark.parametrize(
    "image",
    [
        picture(40, 56),
        picture(40, 56)[:, ::-1],
        picture(40, 56)[..., :1],
        picture(40, 56)[..., 0],
        picture(40, 56).astype(np.float32) / np.float32(255),
        picture(40, 56)[..., 0].astype(np.float32) / np.float32(255),
    ],
)
@pytest.mark.parametrize("name", ["gaussian_noise", "spatter", "fog:2+jpeg_compression"])
def test_shape_and_dtype_stay_and_floats_are_corrupted_like_their_8_bit_values(name, image):
    before, transform = image.copy(), CorruptionTransform([name], [5])
    out = transform(image, key="k")
    assert (out.shape, out.dtype) == (image.shape, image.dtype)
    np.testing.assert_array_equal(image, before)
    assert not np.array_equal(out, image)
    assert not np.shares_memory(out, image)
    if image.dtype == np.float32:
        between = np.clip(image * 255 + np.random.default_rng(0).uniform(-0.4, 0.4, image.shape), 0, 255)
        expected = transform(np.rint(image * 255).astype(np.uint8), key="k")
        out = transform((between / 255).astype(np.float32), key="k")
        np.testing.assert_array_equal(np.rint(out * 255).astype(np.uint8), expected)


def test_transform_equals_the_corruption_of_that_name_and_severity():
    """The transform gives the same result as the corruption with the random stream described in the module's
    docstring.
    """
    image, corruption = picture(40, 56), load_corruption("fog")
    stream = Rng.of("robustflow transform", 7, "key", "a").spawn("draw")
    expected = corruption.apply(image, corruption.draw(stream, 2, image.shape[:2]), 0)
    np.testing.assert_array_equal(CorruptionTransform(["fog"], [2], seed=7)(image, key="a"), expected)


def test_frames_of_a_clip_share_the_parameters_that_a_pair_shares():
    frames = [picture(40, 56, seed=index) for index in range(3)]
    transform = CorruptionTransform(["frost"], [4])
    clip = transform(frames, key="clip")
    for one, index in zip(clip, range(3), strict=True):
        np.testing.assert_array_equal(one, transform(frames[index], key="clip"))
    noise = CorruptionTransform(["gaussian_noise"], [4])
    flat = np.full((32, 32, 3), 128, np.uint8)
    first, second = noise((flat, flat), key="clip")
    assert not np.array_equal(first, second)
    assert isinstance(noise((flat, flat)), tuple)
    stacked = noise(np.stack([flat, flat]), key="clip")
    np.testing.assert_array_equal(stacked, np.stack([first, second]))


def test_grey_images_get_full_noise_or_the_luma_of_colour_corruptions():
    flat = np.full((200, 200), 128, np.uint8)
    for name in ("gaussian_noise", "pixelate+gaussian_noise"):
        noisy = CorruptionTransform([name], [1])(flat, key=0).astype(float)
        assert noisy.std() == pytest.approx(0.08 * 255, rel=0.03)
    grey = picture(64, 64)[..., :1]
    colour = np.repeat(grey, 3, axis=2)
    for name in ("spatter", "fog+spatter"):
        transform = CorruptionTransform([name], [5])
        expected = cv2.cvtColor(transform(colour, key=1), cv2.COLOR_RGB2GRAY)
        np.testing.assert_array_equal(transform(grey, key=1)[..., 0], expected)


def test_draws_depend_on_the_key_or_on_the_number_of_the_call():
    transform = CorruptionTransform(["impulse_noise"], [3], seed=1)
    image = picture(40, 56)
    again = CorruptionTransform(["impulse_noise"], [3], seed=1)
    firsts = [transform(image) for _ in range(3)]
    seconds = [again(image) for _ in range(3)]
    np.testing.assert_array_equal(firsts, seconds)
    assert len({out.tobytes() for out in firsts}) == 3
    np.testing.assert_array_equal(transform(image, key="x"), again(image, key="x"))
    assert (transform(image, key="x") != transform(image, key="y")).any()
    assert (CorruptionTransform(["impulse_noise"], [3], seed=2)(image, key="x") != again(image, key="x")).any()


def test_names_severities_and_probability_are_drawn_as_requested():
    image = np.full((16, 16, 3), 100, np.uint8)
    transform = CorruptionTransform(["high_light", "low_light"], [1, 2], probability=0.5)
    seen = [int(transform(image, key=key)[0, 0, 0]) for key in range(400)]
    counts = {value: seen.count(value) for value in set(seen)}
    assert set(counts) == {100, 126, 151, 74, 49}
    assert 160 <= counts.pop(100) <= 240
    assert all(25 <= count <= 75 for count in counts.values())


class Dim:
    """Subtracts the severity."""

    def draw(self, rng, severity, shape):
        return severity

    def apply(self, frame, state, index):
        return frame - np.uint8(state)


@pytest.mark.parametrize("made", [Dim, Dim()])
def test_a_custom_corruption_is_a_class_or_an_object(made):
    transform = CorruptionTransform([made, "contrast"], [3])
    assert transform.names == ("dim", "contrast")
    flat = np.full((8, 8, 3), 100, np.uint8)
    assert {int(transform(flat, key=key)[0, 0, 0]) for key in range(20)} == {97, 100}


def test_transform_draws_only_severities_of_the_scale():
    name = next(name for name in IMAGE_PAIR if 0 < len(calibrated_levels(name)) < 5)
    known = calibrated_levels(name)
    lacking = [level for level in range(1, 6) if level not in known]
    CorruptionTransform([name], scale="calibrated")(picture(40, 56), key=0)
    refusal(lambda: CorruptionTransform([name], lacking, scale="calibrated"), UsageError, name)


def test_a_pickled_copy_continues_where_the_original_stood():
    transform, image = CorruptionTransform(["shot_noise"], [2]), picture(40, 56)
    transform(image)
    copy = pickle.loads(pickle.dumps(transform))
    np.testing.assert_array_equal(copy(image), transform(image))


def _send_two(transform, pipe):
    flat = np.full((16, 16, 3), 128, np.uint8)
    pipe.send([transform(flat).tobytes() for _ in range(2)])


def test_processes_with_copies_of_one_transform_have_different_draws():
    transform = CorruptionTransform(["gaussian_noise"], [3])
    context = multiprocessing.get_context("fork")
    drawn = []
    for _ in range(2):
        ours, child = context.Pipe()
        process = context.Process(target=_send_two, args=(transform, child))
        process.start()
        drawn += ours.recv()
        process.join()
    flat = np.full((16, 16, 3), 128, np.uint8)
    assert len({*drawn, transform(flat).tobytes()}) == 5


def test_ranks_of_a_distributed_training_have_different_draws(monkeypatch):
    flat, drawn = np.full((16, 16, 3), 128, np.uint8), []
    for rank in ("0", "1"):
        monkeypatch.setenv("RANK", rank)
        transform = CorruptionTransform(["gaussian_noise"], [3])
        drawn.append((transform(flat).tobytes(), transform(flat, key="a").tobytes()))
    assert drawn[0][0] != drawn[1][0]
    assert drawn[0][1] == drawn[1][1]


def test_psf_blur_is_not_a_default():
    assert set(IMAGE_PAIR) - set(CorruptionTransform().names) == {"psf_blur"}


SCRIPT = textwrap.dedent(
    """
    import sys

    import cv2
    import numpy as np
    import torch

    from robustflow.corruptions.transform import CorruptionTransform

    NAMES = sys.argv[2].split(",")


    class Pairs(torch.utils.data.Dataset):
        def __len__(self):
            return len(NAMES)

        def __getitem__(self, index):
            image = (np.indices((160, 224)).sum(0)[..., None] * [1, 2, 3] % 256).astype(np.uint8)
            first, second = CorruptionTransform([NAMES[index]], severities=[3])([image, image], key=index)
            assert first.shape == image.shape and (first != image).any() | (second != image).any(), NAMES[index]
            import numba.np.ufunc.parallel as parallel

            assert not parallel._is_initialized, f"{NAMES[index]} started numba's threads"
            return NAMES[index], torch.from_numpy(first).float().mean()


    if __name__ == "__main__":
        cv2.GaussianBlur(np.zeros((2000, 2000, 3), np.uint8), (0, 0), 5)
        torch.mm(torch.ones(600, 600), torch.ones(600, 600)).sum()
        loader = torch.utils.data.DataLoader(
            Pairs(), batch_size=None, num_workers=2, multiprocessing_context=sys.argv[1], collate_fn=list
        )
        print(",".join(sorted(name for name, _ in loader)))
    """
)


@pytest.mark.parametrize("start", ["fork", "spawn"])
def test_no_corruption_hangs_in_a_worker(start, tmp_path):
    """A thread pool does not survive a fork: a worker that uses one hangs, so each case runs in a separate process with
    a time limit, after torch and OpenCV have used threads in the parent.
    """
    pytest.importorskip("torch")
    if start == "fork" and sys.platform != "linux":
        pytest.skip("fork is the default only on Linux")
    script = tmp_path / "load.py"
    script.write_text(SCRIPT)
    names = [*IMAGE_PAIR, "elastic_transform"]
    threads = {"OMP_NUM_THREADS": "4", "NUMBA_NUM_THREADS": "4", "OPENBLAS_NUM_THREADS": "1"}
    environment = {**os.environ, **threads}
    done = subprocess.run(
        [sys.executable, str(script), start, ",".join(names)],
        capture_output=True, text=True, timeout=150, env=environment, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-2000:]
    assert done.stdout.split() == [",".join(sorted(names))]
