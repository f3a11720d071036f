"""The search order for a checkpoint: a given path, a published name in PyTorch's cache, then a file with that name."""

from pathlib import Path

import pytest

from robustflow.core.errors import ModelError, UsageError
from robustflow.models.torch.network import find_checkpoint

PUBLISHED = {"things": "https://example.org/net-things-0123abcd.pth", "kitti": "https://example.org/kitti.pth"}


def find(checkpoint, published=PUBLISHED):
    return find_checkpoint("net", checkpoint, published, "the authors' file")


def test_path_of_a_checkpoint_is_used_unchanged(tmp_path, monkeypatch):
    path = tmp_path / "mine-0123abcd.pth"
    path.touch()
    assert find(path) == find(str(path)) == (path, None)
    monkeypatch.setenv("HOME", str(tmp_path))
    assert find("~/mine-0123abcd.pth") == (path, None)


@pytest.mark.torch
def test_published_name_takes_precedence_over_a_file_of_that_name(tmp_path, monkeypatch):
    torch = pytest.importorskip("torch", reason="needs the torch extra")
    monkeypatch.setattr(torch.hub, "get_dir", lambda: str(tmp_path / "hub"))
    monkeypatch.chdir(tmp_path)
    fetched = []

    def fetch(url, path, hash_prefix, progress):
        Path(path).touch()
        fetched.append((url, hash_prefix))

    monkeypatch.setattr(torch.hub, "download_url_to_file", fetch)
    Path("things").touch()
    cached = tmp_path / "hub" / "checkpoints"
    for _ in range(2):
        assert find("things") == (cached / "net-things-0123abcd.pth", "0123abcd")
        assert find("kitti") == (cached / "kitti.pth", None)
    assert fetched == [(PUBLISHED["things"], "0123abcd"), (PUBLISHED["kitti"], None)]
    assert find("./things") == (Path("things"), None)


def test_missing_checkpoint_is_refused_with_where_to_get_it():
    with pytest.raises(ModelError, match="needs its checkpoint: choose one of things, kitti, or get the authors' file"):
        find(None)
    with pytest.raises(ModelError, match="needs its checkpoint: get the authors' file, and pass its path"):
        find(None, {})
    with pytest.raises(UsageError, match="unknown checkpoint of net 'thing': did you mean 'things'"):
        find("thing")
    with pytest.raises(ModelError, match=r"no file /nowhere/thing\.pth; choose one of things, kitti, or get"):
        find("/nowhere/thing.pth")
