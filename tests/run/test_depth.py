"""Runs with corruptions that need depth: sources of depth, their effect on the identity, and data without depth."""

from functools import partial
from pathlib import Path

import numpy as np
import polars as pl
import pytest

import robustflow as rf
from robustflow.core.errors import DataError, RunError
from robustflow.core.types import Camera, SceneDepth
from robustflow.corruptions import FAMILIES, DepthCorruption, corrupt
from robustflow.data.benchmarks import load_benchmark
from robustflow.data.benchmarks.export import export
from robustflow.data.datasets import load_dataset
from robustflow.media.images import read_image
from robustflow.run.engines.ray import files_of
from robustflow.run.plan import Job, Unit
from robustflow.run.repeat import recheck, restore_plan
from robustflow.run.run import Run
from robustflow.run.source import RunSource
from robustflow.testing import TexturePairs

from ..refusals import refusal

SHAPES = {"pairs": 2, "size": "64x96"}
NAMES = ("contrast", "fog_3d", "fog+fog_3d:2")


def run(output, benchmark="shapes", data=None, corruptions=NAMES, options=SHAPES, model="dis", **others):
    return rf.evaluate(
        model, benchmark, data, output, corruptions=corruptions, severities=[2, 5], data_options=options,
        examples=False, workers=others.pop("workers", 1), **others,
    )  # fmt: skip


class FilesOfDepth(TexturePairs):
    """A user's dataset in which each depth file contains a single number."""

    name = "files_of_depth"

    def __init__(self, folder):
        super().__init__(1)
        self._folder = Path(folder)

    def depth(self, sample):
        metres = np.full(sample.shape, 10 * int(self.depth_files(sample.key)[0].read_bytes()), np.float32)
        return SceneDepth((metres, metres), (metres > 0, metres > 0), Camera((50.0, 50.0), (20.0, 20.0)))

    def depth_files(self, key):
        return [self._folder / f"{key}.depth"]


class Haze(DepthCorruption):
    """A user's 3D corruption that darkens each pixel in proportion to its depth in metres."""

    paper_severities = (1, 2, 3, 4, 5)

    def draw_scene(self, rng, severity, depth):
        return self.parameter(severity), depth.maps

    def apply(self, frame, state, index):
        steps, maps = state
        return np.clip(frame - steps * maps[index][..., None], 0, 255).astype(np.uint8)


HAZE = f"{__name__}:Haze"


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return run(tmp_path_factory.mktemp("depth") / "run")


@pytest.fixture
def maps(clip_folder, tmp_path):
    """Depth for every frame of `clip_folder`."""
    folder = tmp_path / "maps"
    folder.mkdir()
    for number in range(6):
        np.save(folder / f"{number}.npy", np.full((48, 64), 10 + 5 * number, np.float32))
    return folder


def test_frames_of_a_run_are_those_of_corrupt_and_of_verify_and_of_export(whole, tmp_path):
    assert "14 of 14 rows" in recheck(whole.manifest.identity, whole.rows, options=SHAPES, count=100)
    data = load_dataset("shapes", **SHAPES)
    benchmark = load_benchmark("shapes", options=SHAPES).narrowed(["fog_3d"], [5])
    list(export(benchmark, tmp_path / "frames"))
    for sample in data:
        pair = corrupt(*sample.frames, "fog_3d", 5, key=sample.key, depth=data.depth(sample))
        for number, frame in zip((10, 11), pair, strict=True):
            written = tmp_path / "frames" / "fog_3d_5" / "val" / "image_2" / f"{sample.key}_{number}.png"
            np.testing.assert_array_equal(read_image(written), frame)


def test_the_paper_and_family_means_leave_corruptions_in_depth_out(whole):
    assert {condition for _, condition, _ in whole.means} & {*FAMILIES, "paper"} == {"digital"}


def test_depth_is_not_read_where_nothing_needs_it(monkeypatch, tmp_path):
    from robustflow.data.datasets.shapes.dataset import FlyingShapes

    monkeypatch.setattr(FlyingShapes, "depth", lambda self, sample: pytest.fail("depth was read"))
    assert run(tmp_path / "run", corruptions=["contrast"]).rows.height == 6


def test_an_own_corruption_in_three_dimensions_runs_as_shipped_ones_do(tmp_path):
    data = load_dataset("shapes", **SHAPES)
    result = run(tmp_path / "run", corruptions=[Haze(), f"fog+{HAZE}:2"])
    assert set(result.rows["corruption"]) == {"clean", "haze", "fog+haze:2"}
    list(export(load_benchmark("shapes", options=SHAPES).narrowed([HAZE], [5]), tmp_path / "frames"))
    sample = data["000000"]
    written = read_image(tmp_path / "frames" / "haze_5" / "val" / "image_2" / "000000_10.png")
    metres = data.depth(sample).maps[0][..., None]
    np.testing.assert_array_equal(written, np.clip(sample.frames[0] - 5 * metres, 0, 255).astype(np.uint8))


def test_own_maps_decide_the_frames_and_the_identity_of_a_run(clip_folder, maps, tmp_path):
    first = run(tmp_path / "one", "folder", clip_folder, ["fog_3d"], {"depth": maps})
    assert first.manifest.identity.frames.depth
    assert len(first.manifest.samples["0"]) == 4  # both frames and their depth maps
    again = run(tmp_path / "one", "folder", clip_folder, ["fog_3d"], {"depth": str(maps)})
    assert again.rows.equals(first.rows)
    job = restore_plan(Run(tmp_path / "one"), RunSource.read(tmp_path / "one")).job()
    assert job.depth.depth(job.dataset.load("0")).maps[0][0, 0] == 10
    focal = run(tmp_path / "focal", "folder", clip_folder, ["fog_3d"], {"depth": maps, "focal": 99})
    assert focal.manifest.identity.frames != first.manifest.identity.frames
    unit = run(tmp_path / "unit", "folder", clip_folder, ["fog_3d"], {"depth": maps, "depth_unit": "m/2"})
    assert unit.manifest.identity.frames != first.manifest.identity.frames

    np.save(maps / "3.npy", np.full((48, 64), 44, np.float32))
    again = partial(run, tmp_path / "one", "folder", clip_folder, ["fog_3d"], {"depth": maps})
    assert "depth" in str(refusal(again, RunError, tmp_path / "one"))
    other = run(tmp_path / "two", "folder", clip_folder, ["fog_3d"], {"depth": maps})
    digests = [result.rows.filter(pl.col("corruption") == "fog_3d")["frames_digest"] for result in (first, other)]
    assert 0 < (digests[0] == digests[1]).sum() < len(digests[0])
    refusal(
        lambda: recheck(first.manifest.identity, first.rows, clip_folder, options={"depth": maps}), RunError, "depth"
    )
    assert "rows" in recheck(other.manifest.identity, other.rows, clip_folder, options={"depth": maps}, count=50)


def test_a_still_scene_takes_the_users_maps(clip_folder, maps, tmp_path):
    result = run(tmp_path / "still", "folder", clip_folder, ["fog_3d"], {"depth": maps}, still=True)
    assert result.rows.height == 6 * 3
    assert result.manifest.identity.frames.depth


def test_missing_map_is_refused(clip_folder, maps, tmp_path):
    (maps / "5.npy").unlink()
    refusal(partial(run, tmp_path / "run", "folder", clip_folder, ["fog_3d"], {"depth": maps}), DataError, maps)
    assert not (tmp_path / "run").exists()


def test_run_accepts_depth_later_and_refuses_changed_maps(tmp_path):
    """Check still scenes of a dataset whose depth is stored in separate files."""
    module = "tests.run.test_depth:FilesOfDepth"
    options = {"folder": str(tmp_path)}
    (tmp_path / "0.depth").write_bytes(b"1")
    begun = run(tmp_path / "run", data=module, benchmark="demo", corruptions=["contrast"], options=options)
    assert len(begun.manifest.samples["0"]) == 0
    both = run(tmp_path / "run", data=module, benchmark="demo", corruptions=["fog_3d"], options=options)
    assert [name for name, _ in both.manifest.samples["0"]] == ["0.depth"]
    assert set(Run(both.path).measured.corruptions) == {"contrast", "fog_3d"}
    run(tmp_path / "run", data=module, benchmark="demo", corruptions=["contrast"], options=options)
    (tmp_path / "0.depth").write_bytes(b"2")
    again = partial(run, tmp_path / "run", data=module, benchmark="demo", corruptions=["fog_3d"], options=options)
    assert "'0'" in str(refusal(again, RunError, tmp_path / "run"))


def test_cluster_nodes_must_have_the_depth_of_a_pair(clip_folder, maps, tmp_path):
    benchmark = load_benchmark("folder", clip_folder, options={"depth": maps}).narrowed(["fog_3d"], [1])
    job = Job(benchmark.dataset, depth=benchmark.depths)
    files = [clip_folder / "2.png", clip_folder / "3.png", maps / "2.npy", maps / "3.npy"]
    assert files_of(job, Unit("2", "fog_3d", (1,))) == tuple((str(path), path.stat().st_size) for path in files)
