"""A run is never resumed with a different model or different data of the same name."""

import signal
from dataclasses import replace
from functools import partial

import cv2
import numpy as np
import pytest

import robustflow as rf
from robustflow.core.errors import RunError
from robustflow.data.benchmarks import Benchmark
from robustflow.run.trust import COMPARED, check_same
from robustflow.testing import TexturePairs

from ..refusals import refusal


@pytest.fixture
def frames(tmp_path):
    """Three frames of noise, which form two pairs. They are stored uncompressed, so that a frame can change without a
    change in file size.
    """
    folder = tmp_path / "frames"
    folder.mkdir()
    for index in range(3):
        _paint(folder, index, seed=index)
    return folder


def _paint(folder, index, seed):
    picture = np.random.default_rng(seed).integers(0, 256, (40, 48, 3)).astype(np.uint8)
    cv2.imwrite(str(folder / f"{index:04d}.bmp"), picture)


def _brightness(frame1, frame2):
    return np.stack([frame1[..., 0], frame2[..., 1]], axis=2).astype(np.float32)


def _run(tmp_path, frames, severities, model=_brightness):
    output = tmp_path / "run"
    return rf.evaluate(model, "folder", frames, output, corruptions=["contrast"], severities=severities)


def _threads(frame1, frame2):
    """A flow that shows how many threads OpenCV uses, as the result of some of its methods does."""
    return np.full((*frame1.shape[:2], 2), cv2.getNumThreads(), np.float32)


class Drawn(TexturePairs):
    """Two samples generated from seeds, without files, so that a change is noticed only when they are read again."""

    name = "drawn"

    def __init__(self, *seeds):
        super().__init__(len(seeds), (40, 48))
        self.seeds = seeds
        self.error = 0.0

    def load(self, key):
        sample = TexturePairs(1, (40, 48), seed=self.seeds[int(key)]).load("0")
        return replace(sample, key=key, flow=sample.flow + np.float32(self.error))


def _run_drawn(tmp_path, data, severities, keys=("0", "1")):
    benchmark = Benchmark("drawn", data, keys, ("contrast",), tuple(severities))
    return rf.evaluate(_brightness, benchmark, output=tmp_path / "run")


@pytest.mark.parametrize("severities", [[1], [1, 2]], ids=["complete", "with more to do"])
def test_a_frame_of_the_same_name_and_size_with_other_bytes_stops_a_run(tmp_path, frames, severities):
    before = _run(tmp_path, frames, [1]).rows
    _paint(frames, 2, seed=9)
    refusal(lambda: _run(tmp_path, frames, severities), RunError, tmp_path / "run")
    assert rf.load_run(tmp_path / "run").rows.equals(before)
    _paint(frames, 2, seed=2)
    assert _run(tmp_path, frames, severities).rows.height == 2 * (1 + len(severities))


@pytest.mark.parametrize("severities", [[1], [1, 2]], ids=["complete", "with more to do"])
def test_frames_without_files_are_compared_by_content(tmp_path, severities):
    _run_drawn(tmp_path, Drawn(0, 1), [1])
    refusal(lambda: _run_drawn(tmp_path, Drawn(9, 1), severities), RunError, "0")
    changed = Drawn(0, 1)
    changed.error = 1.0
    refusal(lambda: _run_drawn(tmp_path, changed, severities), RunError, "0")
    assert _run_drawn(tmp_path, Drawn(0, 1), severities).measured.complete


def test_a_call_for_other_samples_compares_one_of_the_earlier_calls(tmp_path):
    before = _run_drawn(tmp_path, Drawn(0, 1), [1], ["0"]).rows
    refusal(lambda: _run_drawn(tmp_path, Drawn(9, 1), [1], ["1"]), RunError, "0")
    assert rf.load_run(tmp_path / "run").rows.equals(before)


def test_every_sample_that_continues_is_compared_not_only_the_first(tmp_path):
    _run_drawn(tmp_path, Drawn(0, 1), [1])
    refusal(lambda: _run_drawn(tmp_path, Drawn(0, 9), [1, 2]), RunError, "1")


def test_weights_at_a_fixed_path_that_changed_stop_a_run(tmp_path, frames, monkeypatch):
    (tmp_path / "model_with_weights_for_test.py").write_text(
        "import numpy as np\nfrom pathlib import Path\n"
        "WEIGHTS = Path(__file__).with_name('weights.npy')\n"
        "class Model:\n"
        "    def __init__(self): self.value = np.load(WEIGHTS)\n"
        "    def predict(self, a, b): return np.full((*a.shape[:2], 2), self.value, np.float32)\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    np.save(tmp_path / "weights.npy", 1.0)
    before = _run(tmp_path, frames, [1], "model_with_weights_for_test:Model").rows
    np.save(tmp_path / "weights.npy", 4.0)
    for severities in ([1], [1, 2]):
        run = partial(_run, tmp_path, frames, severities, "model_with_weights_for_test:Model")
        refusal(run, RunError, "0000")
    np.save(tmp_path / "weights.npy", 1.0)
    after = _run(tmp_path, frames, [1, 2], "model_with_weights_for_test:Model")
    assert after.rows.filter(after.rows["severity"] < 2).equals(before)


def test_an_interrupted_run_continues_with_the_same_model(tmp_path, frames, request):
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored if the tests run in the background
    request.addfinalizer(lambda: signal.signal(signal.SIGINT, before))
    alive = []
    clean = cv2.imread(str(frames / "0000.bmp"))[..., ::-1]

    def dies(frame1, frame2):
        if not alive and not np.array_equal(frame1, clean):
            raise KeyboardInterrupt
        return _brightness(frame1, frame2)

    with pytest.raises(KeyboardInterrupt):
        _run(tmp_path, frames, [1], dies)
    alive.append(True)
    assert _run(tmp_path, frames, [1], dies).rows.height == 4
    assert not (tmp_path / "run/clean").exists()


def test_a_model_whose_flow_depends_on_opencvs_threads_is_resumed_with_one_thread(tmp_path, frames):
    before = cv2.getNumThreads()
    cv2.setNumThreads(4)
    try:
        _run(tmp_path, frames, [1], _threads)
        rows = rf.load_run(_run(tmp_path, frames, [2], _threads).path).rows
    finally:
        cv2.setNumThreads(before)
    assert rows.height == 6
    np.testing.assert_allclose(rows["pred_magnitude_sum"] / rows["n_all"], np.sqrt(2))


SUMS = ("pred_magnitude_sum", "rcre_all_sum", "spread_sum", "photometric_sum", "epe_sum", "n_invalid")


@pytest.mark.parametrize("mean", [1e-3, 1.0, 300.0])
@pytest.mark.parametrize("changed", SUMS)
@pytest.mark.parametrize(("more", "refused"), [(0.95e-3, False), (1.05e-3, True), (-0.95e-3, False), (-1.05e-3, True)])
def test_means_of_a_continued_run_may_differ_by_a_thousandth_of_themselves(changed, mean, more, refused):
    before = {**dict.fromkeys(COMPARED, 100), "sample": "a", **dict.fromkeys(SUMS, 100 * mean)}
    now = {**before, changed: (1 + more) * before[changed]}
    if refused:
        refusal(lambda: check_same(before, now), RunError, "a")
    else:
        check_same(before, now)
