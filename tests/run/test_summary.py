import json

import pytest
from pydantic import ValidationError

from robustflow.api import evaluate
from robustflow.core.errors import RunError, UsageError
from robustflow.metrics.summary import METRICS, Scores, Summary
from robustflow.run.aggregate import summarize
from robustflow.run.run import Run
from robustflow.run.shards import list_shards, read_shards, write_shard
from robustflow.testing import ZeroFlow
from tests.made_rows import rows_frame

from .mean_rows import THREE_IMAGES, row


@pytest.fixture
def summary():
    return summarize(rows_frame(THREE_IMAGES))


def test_summary_table_is_indexed_by_corruption_and_severity(summary):
    assert summary.table("cre").rows(named=True) == [
        {"corruption": "fog", "family": "weather", "1": 3.0, "2": 7.0, "mean": 5.0},
        {"corruption": "snow", "family": "weather", "1": -3.0, "2": None, "mean": -3.0},
    ]


@pytest.mark.parametrize("metric", METRICS)
def test_every_metric_has_a_table(summary, metric):
    table = summary.table(metric)
    assert table.columns == ["corruption", "family", "1", "2", "mean"]
    assert table["mean"].to_list() == [getattr(scores, metric) for scores in summary.corruptions.values()]


def test_table_of_the_clean_frames_alone_is_empty():
    assert summarize(rows_frame([row("a", epe=1.0)])).table().height == 0


def test_unknown_metric_is_named(summary):
    with pytest.raises(UsageError, match="did you mean 'rcre'"):
        summary.table("rcree")


def test_json_has_the_documented_names_and_reads_back(summary):
    text = summary.model_dump_json()
    assert Summary.model_validate_json(text) == summary
    loaded = json.loads(text)
    assert {"epe_clean", "epe", "cre", "crer", "rcre", "corruptions", "regions", "families"} <= set(loaded)
    assert loaded["corruptions"]["fog"]["by_severity"]["epe"] == [7.0, 11.0]
    assert loaded["corruptions"]["fog"]["severities"] == [1, 2]


def test_a_mean_that_is_not_finite_cannot_be_written():
    with pytest.raises(ValidationError):
        Scores(epe=float("nan"))


def test_means_from_shards_equal_those_of_the_rows_with_less_memory(tmp_path):
    path = evaluate(ZeroFlow(), "demo", output=tmp_path, corruptions=["contrast"], severities=[1, 2]).path
    rows = read_shards(list_shards(path / "rows"))
    for averaging in ("image", "pixel"):
        run, paper = Run(path), ["contrast"]
        made = run.summarize(averaging)
        assert "rows" not in vars(run)
        known = summarize(rows, averaging, run.planned(), paper=paper).model_copy(
            update={"paper": made.paper, "paper_over": made.paper_over}
        )
        assert made == known
        assert run.rows.height == rows.height
        assert run.summarize(averaging) == made, "from the rows in memory"
    write_shard(path / "rows", "left-by-a-crash", rows.head(1))
    assert Run(path).summarize("pixel") == made
    (path / "rows" / list_shards(path / "rows")[0].name).write_bytes(b"PAR1")
    with pytest.raises(RunError, match="is damaged"):
        Run(path).summarize()
