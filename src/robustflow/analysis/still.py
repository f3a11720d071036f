"""Phantom motion: the motion that a model predicts where nothing moves."""

from __future__ import annotations

from ..benchmarks.facts import is_still
from ..runs.run import Run
from .labels import inside, long_label

PHANTOM = (
    "Nothing moves in these frames, so EPE measures phantom motion: bias on clean frames, flicker under corruption. "
    "A model that always predicts zero flow has none; its error on moving scenes shows the cost."
)
"""The explanation shown with errors on still scenes."""


def phantom_motion(run: Run) -> str:
    """Describe the phantom motion of a run on still scenes in one sentence; "" for other runs, or if nothing was
    measured."""
    clean, corrupted = run.summary.epe_clean, run.summary.epe
    if not is_still(run.benchmark) or clean is None:
        return ""
    sentence = f"phantom motion: {clean:.3f} px on clean frames"
    known = {name: scores.epe for name, scores in run.summary.corruptions.items() if scores.epe is not None}
    if corrupted is None or not known:
        return sentence
    sentence += f", {corrupted:.3f} px under corruption"
    most = max(known, key=lambda name: known[name])
    if len(known) > 1 and known[most] > min(known.values()):
        sentence += f", most under {inside(long_label(most))} ({known[most]:.3f} px)"
    if run.summary.spread is not None:
        draws = run.manifest.identity.measuring.draws
        sentence += f"; the flow's standard deviation over {draws} draws is {run.summary.spread:.3f} px"
    return sentence
