"""What `manifest.json` says of a run, brought up to date with what is asked for now."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime
from typing import Any

from ..benchmarks.setting import manifest_provenance
from ..datasets.base import Clips
from ..datasets.context_frames import ContextFrames
from ..errors import RunError
from .environment import environment
from .identity import differing, identity_digest
from .plan import Plan
from .store import RunFolder


def open_manifest(folder: RunFolder, plan: Plan) -> dict[str, Any]:
    """The folder's manifest brought up to date with this plan, or an error where the two do not belong together.

    What another run left that ended before its first row counts for nothing.
    """
    identity = plan.identity()
    old = folder.manifest() or {}
    if old and old["identity_digest"] != identity_digest(identity) and folder.rows().is_empty():
        folder.keep_clean(())
        old = {}
    if old and old["identity_digest"] != identity_digest(identity):
        raise RunError(
            f"{folder.path} holds another run (it differs in: {differing(identity, old['identity'])}); "
            "choose another folder with --output"
        )
    samples = {key: _fingerprint(plan, key) for key in plan.benchmark.keys}
    before = old.get("samples", {})
    changed = sorted(key for key in samples if before.get(key, samples[key]) != samples[key])
    if changed:
        raise RunError(
            f"{folder.path} was made from other files for sample '{changed[0]}' ({len(changed)} differ); "
            "choose another folder with --output"
        )
    selection = old.get("selection", {"corruptions": [], "severities": []})
    gone = old.get("left_out", {})
    left_out = {
        name: sorted(set(gone.get(name, [])) | set(levels)) for name, levels in {**gone, **plan.left_out()}.items()
    }
    known = {
        "identity": identity,
        "samples": before | samples,
        "provenance": _provenance(old.get("provenance"), plan.provenance),
    }
    return {
        **known,
        "identity_digest": identity_digest(identity),
        "provenance": manifest_provenance(known),
        "selection": {
            "corruptions": _union(selection["corruptions"], plan.benchmark.corruptions),
            "severities": sorted(set(selection["severities"]) | set(plan.benchmark.severities)),
        },
        **({"left_out": left_out} if left_out else {}),
        "started": old.get("started", now()),
        "finished": None,
        "seconds": old.get("seconds", {}),
        "environment": environment(),
    }


def _provenance(before: dict[str, Any] | None, given: dict[str, Any]) -> dict[str, Any]:
    """What was declared before stays when nothing is declared now."""
    return before if before and given.get("basis") == "undeclared" else given


def _fingerprint(plan: Plan, key: str) -> list[list[Any]]:
    """Names and sizes of a sample's files: enough to notice other data under the same names, cheap to compute."""
    dataset, window = plan.benchmark.dataset, plan.options.window
    files = dataset.files(key)
    if window is not None:
        assert isinstance(dataset, Clips)
        files = list(dict.fromkeys([*files, *ContextFrames(dataset, window).files(key)]))
    try:
        return [[path.name, path.stat().st_size] for path in files]
    except OSError as error:
        raise RunError(f"cannot read {error.filename}: {error.strerror}") from error


def _union(first: Sequence[str], second: Sequence[str]) -> list[str]:
    return list(dict.fromkeys((*first, *second)))


def now() -> str:
    """The time in UTC, to the second."""
    return datetime.now(UTC).isoformat(timespec="seconds")
