"""State what runs on a user's own frames show without ground truth, and how strong the evidence is."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import islice
from typing import TYPE_CHECKING

from ..core.errors import RunError
from ..core.text import counted, plain
from ..data.benchmarks import benchmark_facts
from ..data.benchmarks.facts import sample_noun
from ..metrics.rows import CLEAN
from .model_result import ModelResult, by_frames, not_ranked, ranked
from .results import AVERAGE, long_label
from .uncertainty import compare_leaders, intervals
from .uncertainty.bootstrap import enough_clusters, fewest_clusters
from .uncertainty.paired import MOST_COMPARED, p_text

if TYPE_CHECKING:
    from ..run.run import Run

CAVEAT = (
    "RCRE measures how much the flow changes, not whether it is wrong: a model that ignores its frames has the lowest "
    "RCRE, and only its photometric error, close to that of zero flow, distinguishes it from a robust model."
)


def without_truth(run: Run) -> bool:
    """Whether a run used frames without ground truth for which the paper has no results, such as the user's own
    frames."""
    benchmark = run.benchmark
    return not benchmark_facts(benchmark).published and run.epe_clean is None and run.rcre is not None


def conclusions(results: Iterable[ModelResult]) -> list[str]:
    """Write one conclusion for each set of frames without ground truth: which corruption changes the flow most or, for
    several models, which model's flow changes least; how strong the evidence is; and what additional data would
    help."""
    own = (line for line in results if line.run is not None and without_truth(line.run))
    return [conclusion(lines) for lines in by_frames(own).values()]


def conclusion(results: Sequence[ModelResult]) -> str:
    """Write the conclusion for runs on the same frames without ground truth."""
    sound = {line.name: line.run for line in ranked(results) if line.run is not None}
    sentences = []
    if len(sound) == 1:
        sentences.append(_one_run(*next(iter(sound.items()))))
    elif sound:
        sentences.append(_several_runs(sound))
    if reasons := not_ranked(results):
        sentences.append(f"No conclusion about {'; '.join(reasons)}.")
    return " ".join([*sentences, CAVEAT])


def _one_run(name: str, run: Run) -> str:
    values = _rcre_by_corruption(run)
    order = sorted(values, key=lambda corruption: -values[corruption])
    moved = f"{run.rcre:.2f} px on average (RCRE)"
    moves = f"On {_evidence(run)}, corruption changes the flow of {plain(name)} by {moved}"
    if len(order) > 1:
        most, least = (
            f"{long_label(corruption)} ({values[corruption]:.2f} px)" for corruption in (order[0], order[-1])
        )
        moves += f", most under {plain(most)} and least under {plain(least)}"
    clean = f"on clean frames the flow is {_clean_length(run)} long on average"
    error, still = run.mean("photometric"), run.mean("photometric_still", CLEAN)
    if error is not None and still is not None:
        errors = f"{run.mean('photometric', CLEAN) or 0.0:.2f}, under corruption {error:.2f} grey levels"
        clean += f", and its photometric error is {errors} (zero flow: {still:.2f})"
    return f"{moves}; {clean}; {_certainty(run)}."


def _clean_length(run: Run) -> str:
    length = run.mean("flow_length", CLEAN)
    return f"{length or 0.0:.2f} px"


def _certainty(run: Run) -> str:
    """State how certain a run's mean is and what would make it more certain."""
    rows = intervals(run.rows, corruptions=False, metrics=("rcre",)).filter(corruption=AVERAGE)
    low, high = rows.select("low", "high").row(0) if rows.height else (None, None)
    if low is None and enough_to_compare(run):
        return f"one {_unit(run)} decides this mean, so no interval can be given; {_more_data(run)} would help"
    if low is None:
        return _too_few(run)
    return f"95 % interval {low:.2f} to {high:.2f} px, which {_more_data(run)} would narrow"


def _several_runs(runs: Mapping[str, Run]) -> str:
    runs = dict(sorted(runs.items(), key=lambda item: (item[1].rcre or 0.0, item[0])))
    (best, best_run), (second, second_run), *_ = ((plain(name), run) for name, run in runs.items())
    first, other = (f"{run.rcre:.2f} px for a clean flow of {_clean_length(run)}" for run in (best_run, second_run))
    if best_run.rcre == second_run.rcre:
        head = f"the flows of {best} and {second} change equally on average (RCRE {best_run.rcre:.2f} px)"
    else:
        head = f"the flow of {best} changes least on average (RCRE {first}; {second} {other})"
    return f"On {_evidence(best_run)}, {head}; {_difference(runs)}."


def _difference(runs: Mapping[str, Run]) -> str:
    """State whether the difference between the first two of several runs, given in order, is significant."""
    best, second = (plain(name) for name in list(runs)[:2])
    run = next(iter(runs.values()))
    try:
        pair = compare_leaders({name: run.rows for name, run in islice(runs.items(), MOST_COMPARED)}, "rcre")
    except RunError:
        return "it is unknown whether the difference is due to chance, because the runs have no measurements in common"
    if pair is None or (p := pair["p_holm"]) is None:
        return _too_few(run)
    if p < 0.05:
        return f"the difference between {best} and {second} is significant (p {p_text(p)}) for scenes like these"
    return (
        f"the difference between {best} and {second} may be due to chance (p {p_text(p)}); {_more_data(run)} would help"
    )


def enough_to_compare(run: Run) -> bool:
    """Whether a run has enough independent pairs to generalise a difference to other frames."""
    return enough_clusters(_counts(run)[1])


def _too_few(run: Run) -> str:
    _, clusters = _counts(run)
    more = max(1, fewest_clusters() - clusters)
    return (
        f"{counted(clusters, _unit(run))} {'is' if clusters == 1 else 'are'} too few to say whether this holds for "
        f"other frames; at least {more} more from different scenes {'are' if more > 1 else 'is'} needed"
    )


def _evidence(run: Run) -> str:
    pairs, clusters = _counts(run)
    return counted(pairs, sample_noun(run.benchmark)) + (
        f" in {counted(clusters, 'sequence')}" if clusters != pairs else ""
    )


def _unit(run: Run) -> str:
    pairs, clusters = _counts(run)
    return sample_noun(run.benchmark) if clusters == pairs else "sequence"


def _more_data(run: Run) -> str:
    return f"more {_unit(run)}s from different scenes"


def _counts(run: Run) -> tuple[int, int]:
    """Return the numbers of pairs and of independent groups of pairs."""
    clean = run.rows.filter(corruption=CLEAN)
    return clean["sample"].n_unique(), clean["group"].n_unique()


def _rcre_by_corruption(run: Run) -> dict[str, float]:
    of_each = ((name, run.mean("rcre", name)) for name in run.measured.averaged_over)
    return {name: rcre for name, rcre in of_each if rcre is not None}
