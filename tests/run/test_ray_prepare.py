"""Clips prepared on a Ray cluster have the same files, whatever happens to its nodes."""

from fractions import Fraction

import pytest

from robustflow.core.errors import RunError
from robustflow.data.video.prepare import Preparation
from robustflow.data.video.prepare_folder import find_sources
from robustflow.run.engines import ray_prepare
from tests.data.video import clips

pytestmark = pytest.mark.ray

PLAIN = Preparation(fps=Fraction(240), factor=1, step=16, preset="ultrafast")


@pytest.fixture
def recordings(tmp_path):
    clips.folder(tmp_path / "data" / "one", 3)
    clips.folder(tmp_path / "data" / "two", 3, 32, 48)
    return tmp_path / "data"


def test_a_folder_that_a_node_does_not_see_is_named(recordings, tmp_path, monkeypatch):
    """Run the node's part on this machine, without the check for a shared folder."""
    monkeypatch.setattr(ray_prepare, "_APPEARS_S", 0.2)
    (source, _) = find_sources(recordings)
    here = ray_prepare.installed()
    shared = tmp_path / "out" / ".shared-0"
    kind, (error, _, _, culprit) = ray_prepare._prepare(source, tmp_path / "out" / "one", PLAIN, shared, "/", here)
    assert (kind, error) == ("error", "DataError")
    assert culprit.startswith("node ")
    assert not (tmp_path / "out").exists()
    kind, (error, _, _, culprit) = ray_prepare._prepare(source, tmp_path, PLAIN, recordings, "/", {"numpy": "0.1"})
    assert (kind, error) == ("error", RunError.__name__)
    assert culprit.startswith("node ")


@pytest.mark.parametrize(
    ("options", "culprit"),
    [
        (["--engine", "rey"], "'rey'"),
        (["--address", "auto"], "--address"),
        (["--engine", "ray", "--workers", "0"], "--workers"),
    ],
)
def test_contradictory_options_of_prepare_are_refused(recordings, tmp_path, robustflow, options, culprit):
    folders = ["-d", recordings, "-o", tmp_path / "out", "--fps", "240", "--factor", "1"]
    assert culprit in robustflow.refuses("prepare", "gopro-fc", *folders, *options)
