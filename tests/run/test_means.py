"""Means over images, severities and corruptions: given rows, a naive loop, and independence of the order of rows."""

from __future__ import annotations

import itertools
import random
from statistics import fmean

import polars as pl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robustflow.api import evaluate
from robustflow.core.errors import RunError, UsageError
from robustflow.corruptions.registry import FAMILIES, IMAGE_PAIR, PAPER_ORDER
from robustflow.metrics.cube import averaged_corruptions
from robustflow.metrics.measures import METRICS
from robustflow.metrics.rows import ROW_SCHEMA
from robustflow.run.run import Run
from robustflow.run.store import list_shards, read_shards, write_shard
from robustflow.run.summary import summarize
from robustflow.testing import ZeroFlow
from tests.made_rows import rows_frame
from tests.refusals import refusal

from .mean_rows import COUNTS, NO_TRUTH, THREE_IMAGES, row

MEASURED = ("epe_sum", "rcre_sum", "rcre_all_sum", "clean_epe_sum", "wauc_sum", "n_truth", "n_valid", *COUNTS)
OCC = ("epe_sum_occ", "clean_epe_sum_occ", "rcre_sum_occ", "fl_count_occ")


def numbers(means, condition, *measures, severity=None):
    """The means of one condition."""
    return tuple(means.get((measure, condition, severity)) for measure in measures)


def test_image_means_equal_hand_computed_values():
    """Averaging each image first gives (1 + 3 + 8) / 3 for the clean frames, 7 and 11 for fog, and 1 for snow."""
    means, measured = summarize(rows_frame(THREE_IMAGES))
    assert numbers(means, "clean", "epe", "cre") == (4.0, None)
    assert [numbers(means, "fog", "epe", "cre", severity=level) for level in (1, 2)] == [(7.0, 3.0), (11.0, 7.0)]
    assert numbers(means, "fog", "epe", "cre", "crer", "rcre", "rcre_all") == (9.0, 5.0, 1.25, 6.0, 9.0)
    assert numbers(means, "snow", "epe", "cre", "crer", "rcre") == (1.0, -3.0, -0.75, 2.0)
    # Corruptions have equal weight, whatever their number of severities.
    assert numbers(means, "average", "epe", "cre", "crer", "rcre") == (5.0, 1.0, 0.25, 4.0)
    assert numbers(means, "weather", "epe", "cre") == (5.0, 1.0)
    assert measured.complete


@pytest.mark.parametrize(
    ("rows", "culprit"),
    [
        (rows_frame([*THREE_IMAGES, THREE_IMAGES[7]]), "b"),
        (rows_frame(THREE_IMAGES).drop("n_all"), "n_all"),
        *(
            (rows_frame([row("a", n_occ=5, **dict.fromkeys(OCC, 1))]).with_columns(pl.lit(None, kind).alias(name)), "a")
            for name, kind in ROW_SCHEMA.items()
            if name in (*MEASURED, *OCC)
        ),
    ],
)
def test_rows_that_occur_twice_or_lack_a_measure_of_their_pixels_are_refused(rows, culprit):
    refusal(lambda: summarize(rows), RunError, culprit)


def test_mean_over_the_papers_corruptions_needs_all_of_them():
    paper = [row("a", name, 1, epe=2.0 + i) for i, name in enumerate(IMAGE_PAIR)]
    clean, elastic = row("a", epe=1.0), row("a", "elastic_transform", 1, epe=100.0)
    means, measured = summarize(rows_frame([clean, *paper, elastic]))
    assert means["epe", "average", None] == pytest.approx((20 * 11.5 + 100) / 21)
    assert (*numbers(means, "paper", "epe", "cre"), measured.paper_over) == (11.5, 10.5, list(IMAGE_PAIR))
    means, _ = summarize(rows_frame([clean, *paper]))
    assert numbers(means, "average", *METRICS) == numbers(means, "paper", *METRICS)
    for rows, all_of in (([clean, *paper[1:], elastic], IMAGE_PAIR), ([clean, *paper], PAPER_ORDER)):
        means, measured = summarize(rows_frame(rows), paper=all_of)
        assert (numbers(means, "paper", "epe"), measured.paper_over) == ((None,), [])


PLANNED = [(one["sample"], one["corruption"], one["severity"]) for one in THREE_IMAGES]
MORE = [*PLANNED, ("b", "snow", 2), ("a", "snow", 2), ("d", "clean", 0)]
EQUAL = [*PLANNED, *((key, "fog", level) for key in "ba" for level in (4, 5))]


WHOLE = rows_frame(THREE_IMAGES)


@pytest.mark.parametrize(
    ("rows", "planned", "missing", "unmeasured"),
    [
        (WHOLE, PLANNED, [], []),
        (WHOLE, MORE, [([("clean", 0)], ["d"]), ([("snow", 2)], ["a", "b"])], []),
        (WHOLE, EQUAL, [([("fog", 4), ("fog", 5)], ["a", "b"])], []),
        (WHOLE.remove(sample="a", corruption="fog", severity=1), None, [([("fog", 1)], ["a"])], []),
        (WHOLE.remove(sample="b", corruption="clean"), None, [([("clean", 0)], ["b"])], []),
        (
            rows_frame([*THREE_IMAGES[:-1], row("c", "snow", 1, n=0, n_all=0, n_invalid=60)]),
            None,
            [],
            [([("snow", 1)], ["c"])],
        ),
    ],
)
def test_missing_rows_and_rows_without_a_measured_pixel_are_listed(rows, planned, missing, unmeasured):
    measured = summarize(rows, planned=planned).measured
    assert [tuple(each.model_dump().values()) for each in measured.missing] == missing
    assert [tuple(each.model_dump().values()) for each in measured.unmeasured] == unmeasured
    assert measured.complete == (missing == unmeasured == [])
    assert measured.n_invalid == 60 * len(unmeasured)
    assert (measured.corruptions, measured.severities) == ({"fog": [1, 2], "snow": [1]}, [1, 2])


sums = st.floats(0, 1e6)


@st.composite
def runs(draw):
    """Rows of a run in which anything may be missing, including ground truth or all measured pixels."""
    samples = draw(st.lists(st.sampled_from("abcdef"), min_size=1, unique=True))
    truth = {sample: draw(st.booleans()) for sample in samples}
    rows = []
    for sample, (corruption, severity) in itertools.product(
        samples, [("clean", 0), ("fog", 1), ("fog", 2), ("snow", 5), ("elastic_transform", 1)]
    ):
        if draw(st.integers(0, 9)) == 0:
            continue
        n = draw(st.integers(0, 50))
        counts = {name: draw(st.integers(0, n)) for name in COUNTS}
        n_occ = draw(st.integers(0, n))
        occ = {name: draw(sums) for name in ("epe_sum_occ", "rcre_sum_occ", "clean_epe_sum_occ")}
        occ |= {"n_occ": n_occ, "fl_count_occ": n_occ // 2}
        values = {name: draw(sums) for name in ("epe_sum", "clean_epe_sum", "rcre_sum", "rcre_all_sum", "wauc_sum")}
        values["n_truth"] = n + draw(st.integers(0, 9))
        r = row(sample, corruption, severity, n, **counts | values | occ)
        rows.append(r if truth[sample] else r | NO_TRUTH | dict.fromkeys(occ))
    return rows


@settings(max_examples=25)
@given(runs(), st.sampled_from(["image", "pixel"]), st.randoms(use_true_random=False))
def test_neither_the_order_of_rows_nor_reading_a_column_at_a_time_changes_a_bit(rows, averaging, rng: random.Random):
    shuffled = rng.sample(rows, len(rows))
    expected = summarize(rows_frame(rows), averaging)
    halves = pl.concat([rows_frame(shuffled[::2]), rows_frame(shuffled[1::2])])
    assert summarize(halves, averaging) == expected
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("robustflow.metrics.cube._FEW_ROWS", -1)
        assert summarize(rows_frame(shuffled).lazy(), averaging) == expected


def _naive_mean(pairs, averaging):
    """The mean from (sum, count) per image."""
    pairs = [(total, n) for total, n in pairs if n]
    if not pairs:
        return None
    if averaging == "image":
        return sum(total / n for total, n in pairs) / len(pairs)
    return sum(total for total, _ in pairs) / sum(n for _, n in pairs)


def _naive_scores(rows, averaging, total="epe_sum", moved="rcre_sum", count="n_valid"):
    """EPE, CRE and RCRE of every setting, computed directly from the definitions."""
    by_key = {(r["sample"], r["corruption"], r["severity"]): r for r in rows}
    out = {}
    for corruption, severity in sorted({(c, s) for _, c, s in by_key}):
        found = {sample: r for (sample, c, s), r in by_key.items() if (c, s) == (corruption, severity)}
        both = [
            (found[s], by_key[s, "clean", 0])
            for s in found
            if found[s][count] and by_key.get((s, "clean", 0), {}).get(count)
        ]
        after = _naive_mean([(r[total], r[count]) for r, _ in both], averaging)
        before = _naive_mean([(r[f"clean_{total}"], r[count]) for r, _ in both], averaging)
        anywhere = [
            (r["rcre_all_sum"], r["n_all"]) if count == "n_valid" and r[count] is None else (r[moved], r[count])
            for r in found.values()
        ]
        out[corruption, severity] = {
            "epe": _naive_mean([(r[total], r[count]) for r in found.values()], averaging),
            "cre": None if after is None else after - before,
            "rcre": _naive_mean(anywhere, averaging),
        }
    return out


def _mean(values):
    known = [value for value in values if value is not None]
    return pytest.approx(fmean(known), rel=1e-9, abs=1e-6) if known else None


@settings(max_examples=40)
@given(runs(), st.sampled_from(["image", "pixel"]))
def test_means_equal_the_naive_loop(rows, averaging):
    frame = rows_frame(rows)
    means, measured = summarize(frame, averaging)
    seen = {row["corruption"] for row in rows if (row["n_all"] if row["n_valid"] is None else row["n_valid"]) > 0}
    assert set(measured.averaged_over) == averaged_corruptions(frame) & seen
    expected = _naive_scores(rows, averaging)
    inside = _naive_scores(rows, averaging, "epe_sum_occ", "rcre_sum_occ", "n_occ")
    assert means.get(("epe", "clean", None)) == _mean([expected.get(("clean", 0), {}).get("epe")])
    has_region = any(condition == "occ" for _, condition, _ in means)
    if has_region:
        assert means.get(("epe_clean", "occ", None)) == _mean([inside.get(("clean", 0), {}).get("epe")])
    for metric in ("epe", "cre", "rcre"):
        for name, levels in measured.corruptions.items():
            values = [expected[name, level][metric] for level in levels]
            assert [means.get((metric, name, level)) for level in levels] == [_mean([value]) for value in values]
            assert means.get((metric, name, None)) == _mean(values)
        for group, members in (("average", measured.averaged_over), ("weather", FAMILIES["weather"])):
            assert means.get((metric, group, None)) == _mean([means.get((metric, name, None)) for name in members])
        if has_region:
            each = [[inside[key][metric] for key in inside if key[0] == name] for name in measured.averaged_over]
            of_names = [fmean(known) for values in each if (known := [value for value in values if value is not None])]
            assert means.get((metric, "occ", None)) == _mean(of_names)


def test_means_from_shards_equal_those_of_the_rows_with_less_memory(tmp_path):
    path = evaluate(ZeroFlow(), "demo", output=tmp_path, corruptions=["contrast"], severities=[1, 2]).path
    rows = read_shards(list_shards(path / "rows"))
    for averaging in ("image", "pixel"):
        run = Run(path)
        made = run.average(averaging)
        assert "rows" not in vars(run)
        assert made == summarize(rows, averaging, run.planned())
        assert run.rows.height == rows.height
        assert run.average(averaging) == made, "from the rows in memory"
    write_shard(path / "rows", "left-by-a-crash", rows.head(1))
    assert Run(path).average("pixel") == made
    (path / "rows" / list_shards(path / "rows")[0].name).write_bytes(b"PAR1")
    with pytest.raises(RunError):
        Run(path).average()


def test_table_has_a_line_for_each_corruption_and_a_column_for_each_severity(tmp_path):
    run = evaluate(ZeroFlow(), "demo", output=tmp_path, corruptions=["fog", "contrast"], severities=[1, 2])
    for metric in METRICS:
        table = run.table(metric)
        assert table.columns == ["corruption", "family", "1", "2", "mean"]
        assert table.select("corruption", "family").rows() == [("contrast", "digital"), ("fog", "weather")]
        for name, values in zip(("contrast", "fog"), table.select("1", "2", "mean").rows(), strict=True):
            assert list(values) == [run.mean(metric, name, level) for level in (1, 2, None)]
    refusal(lambda: run.table("rcree"), UsageError, "rcree")
