"""Facts about a run, shared by both formats: means with intervals, and warnings."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cached_property

from ...analysis.exclusion import exclusion_reasons
from ...analysis.labels import SETTING_EXPLANATIONS, SETTING_LABELS
from ...analysis.results import AVERAGE, CLEAN
from ...analysis.run_results import comparison_note, run_results, run_setting
from ...benchmarks import benchmark_facts
from ...metrics.summary import has_gaps
from ...runs.run import Run
from ...text import plain


@dataclass(frozen=True)
class RunMean:
    """A mean value of a run."""

    metric: str
    condition: str
    value: float
    interval: tuple[float, float] | None


class RunFacts:
    """Description of a run for the export formats. Names are safe to print, but not escaped for any format."""

    def __init__(self, run: Run) -> None:
        self.run = run
        self.name = plain(run.name)
        self.title = plain(benchmark_facts(run.benchmark).title)
        self.digest = run.manifest.identity_digest

    @cached_property
    def means(self) -> list[RunMean]:
        """The clean and average means."""
        (line,) = run_results([self.run])
        return [
            RunMean(*key, value.number, line.intervals.get(key))
            for key, value in line.values.items()
            if key[1] in (CLEAN, AVERAGE)
        ]

    @cached_property
    def warnings(self) -> list[str]:
        """Caveats that a reader needs to know before comparing the numbers."""
        run, summary, out = self.run, self.run.summary, []
        if run.setting not in ("OOD", "knowledge"):
            setting = run_setting(run)
            out.append(
                f"{SETTING_LABELS.get(setting, setting)}: {SETTING_EXPLANATIONS.get(setting, 'see the manifest')}."
            )
        if note := comparison_note(run):
            out.append(f"This is {note}.")
        if reasons := exclusion_reasons(run):
            out.append(f"Not ranked, because {' and '.join(reasons)}.")
        if not summary.complete:
            out.append("The run is incomplete: some rows are missing or have no valid pixels.")
        if has_gaps(summary):
            out.append(
                f"The model predicted {100 * (summary.coverage or 0):.1f} % of the pixels; errors are computed over "
                "these pixels."
            )
        if self.means and not any(mean.interval for mean in self.means):
            out.append(f"No intervals: too few pairs for a bootstrap ({summary.samples}), or one decides the means.")
        return [plain(each, None) for each in out]

    @property
    def finished(self) -> datetime | None:
        """Return the time at which the run finished, in UTC; None if its manifest does not contain it."""
        try:
            return datetime.fromisoformat(self.run.manifest.finished or "").astimezone(UTC)
        except (ValueError, OverflowError):
            return None

    @property
    def version(self) -> str:
        """Return the RobustFlow version of the run."""
        return plain(self.run.manifest.environment.packages.get("robustflow", "unknown"))
