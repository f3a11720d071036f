from __future__ import annotations

import itertools
import random
from statistics import fmean

import polars as pl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robustflow.core.errors import RunError, UsageError
from robustflow.corruptions.registry import FAMILIES, IMAGE_PAIR, PAPER_ORDER
from robustflow.metrics.regions import REGIONS
from robustflow.metrics.rows import ROW_SCHEMA
from robustflow.metrics.summary import METRICS, has_gaps
from robustflow.run.aggregate import summarize
from robustflow.run.means import image_mean
from tests.made_rows import rows_frame

from .mean_rows import COUNTS, NO_TRUTH, THREE_IMAGES, row


def test_image_means_equal_hand_computed_values():
    """Averaging each image first gives (1 + 3 + 8) / 3 for the clean frames, 7 and 11 for fog, and 1 for snow."""
    summary = summarize(rows_frame(THREE_IMAGES))
    assert summary.epe_clean == 4.0
    fog, snow = summary.corruptions["fog"], summary.corruptions["snow"]
    assert fog.by_severity["epe"] == [7.0, 11.0]
    assert fog.by_severity["cre"] == [3.0, 7.0]
    assert (fog.epe, fog.cre, fog.crer, fog.rcre, fog.rcre_all) == (9.0, 5.0, 1.25, 6.0, 9.0)
    assert (snow.epe, snow.cre, snow.crer, snow.rcre) == (1.0, -3.0, -0.75, 2.0)
    # Corruptions have equal weight, whatever their number of severities.
    assert (summary.epe, summary.cre, summary.crer, summary.rcre) == (5.0, 1.0, 0.25, 4.0)
    assert summary.complete
    assert summary.averaging == "image"


def test_image_mean_is_over_images_with_pixels():
    """Changes of 1, 2 and 9 px over 10, 20 and 90 pixels: mean 4, median 2, over pixels 7.2 px."""
    rows = [row("a", n=10, rcre=1.0), row("b", n=20, rcre=2.0), row("c", n=90, rcre=9.0), row("d", n=0)]
    assert image_mean(rows_frame(rows), "rcre_sum", "n_valid") == 4.0


def test_shares_are_percentages_averaged_like_errors():
    rows = [
        row("a", n=10, fl_count=1, px1_count=5, px3_count=3, px5_count=2, wauc_sum=8.0),
        row("b", n=30, fl_count=30, px1_count=30, px3_count=30, px5_count=30, wauc_sum=0.0),
        row("c", n=40, fl_count=4, px1_count=12, px3_count=8, px5_count=4, wauc_sum=28.0),
    ]
    clean = summarize(rows_frame(rows)).clean
    assert (clean.fl, clean.px1, clean.px3, clean.px5, clean.wauc) == (40.0, 60.0, 50.0, 130 / 3, 50.0)
    pooled = summarize(rows_frame(rows), "pixel").clean
    assert (pooled.fl, pooled.wauc) == (43.75, 45.0)


def _inside(region, n, epe, rcre=0.0, fl=0):
    return {
        f"n_{region}": n,
        f"epe_sum_{region}": epe * n,
        f"rcre_sum_{region}": rcre * n,
        f"fl_count_{region}": fl,
    }


def test_regions_average_over_the_images_that_have_them():
    rows = [
        row("a", n=10, **_inside("occ", 4, 2.0)),
        row("b", n=10, **_inside("occ", 0, 0.0)),
        row("c", n=10),
        row("a", "fog", 1, **_inside("occ", 4, 5.0, rcre=4.0, fl=2)),
        row("b", "fog", 1, n=20, **_inside("occ", 0, 0.0)),  # the share is relative to clean rows
        row("c", "fog", 1),
    ]
    regions = summarize(rows_frame(rows)).regions
    assert list(regions) == ["occ"]
    occ = regions["occ"]
    assert (occ.epe_clean, occ.epe, occ.cre, occ.crer, occ.rcre) == (2.0, 5.0, 3.0, 1.5, 4.0)
    assert (occ.fl_clean, occ.fl, occ.share) == (0.0, 50.0, 20.0)


OTHERS = ("elastic_transform", "fog+jpeg_compression", "my_own_corruption")


@pytest.mark.parametrize(
    "column",
    [
        *("epe_sum", "rcre_sum", "rcre_all_sum", "clean_epe_sum", "wauc_sum", "n_truth", "n_valid", *COUNTS),
        *(f"{name}_{region}" for region in REGIONS for name in ("epe_sum", "clean_epe_sum", "rcre_sum", "fl_count")),
    ],
)
def test_a_row_that_counts_pixels_and_lacks_their_measure_is_refused(column):
    whole = row("a")
    for region in REGIONS:
        whole |= _inside(region, 5, 2.0)
    rows = rows_frame([whole]).with_columns(pl.lit(None, ROW_SCHEMA[column]).alias(column))
    with pytest.raises(RunError, match="row of sample 'a', clean severity 0 counts pixels, but lacks"):
        summarize(rows)


def test_a_run_averages_what_was_requested():
    rows = [row("a", epe=1.0), row("a", "fog", 1, epe=2.0)]
    extra = [row("a", name, 1, epe=101.0 + i) for i, name in enumerate(OTHERS)]
    alone, beside = summarize(rows_frame(rows)), summarize(rows_frame(rows + extra))
    assert beside.averaged_over == ["fog", *OTHERS]
    assert (beside.epe, beside.cre, beside.crer) == (77.0, 76.0, 76.0)
    assert beside.families == alone.families
    for i, name in enumerate(OTHERS):
        assert beside.corruptions[name].cre == 100.0 + i
        assert beside.corruptions[name].family is None
    only = summarize(rows_frame([rows[0], extra[1]]))
    assert (only.epe, only.cre, only.averaged_over) == (102.0, 101.0, ["fog+jpeg_compression"])


def test_the_papers_mean_is_a_second_number_and_needs_all_its_corruptions():
    paper = [row("a", name, 1, epe=2.0 + i) for i, name in enumerate(IMAGE_PAIR)]
    clean, elastic = row("a", epe=1.0), row("a", "elastic_transform", 1, epe=100.0)
    whole = summarize(rows_frame([clean, *paper, elastic]))
    assert whole.epe == pytest.approx((20 * 11.5 + 100) / 21)
    assert (whole.paper.epe, whole.paper.cre, whole.paper_over) == (11.5, 10.5, list(IMAGE_PAIR))
    exact = summarize(rows_frame([clean, *paper]))
    assert all(getattr(exact, metric) == getattr(exact.paper, metric) for metric in METRICS)
    assert summarize(rows_frame([clean, *paper[1:], elastic])).paper is None
    assert summarize(rows_frame([clean, *paper]), paper=PAPER_ORDER).paper is None


def test_cre_is_over_the_same_pixels_and_coverage_is_listed():
    """The corrupted flow lacks the 6 worst of 10 pixels; on the other 4 its error doubled, from 1 to 2 px."""
    clean = row("a", epe=7.0, n_truth=10, clean_epe_sum=70.0)
    fog = row("a", "fog", 1, n=4, epe=2.0, rcre=2.0, n_truth=10, clean_epe_sum=4.0, n_invalid=12)
    summary = summarize(rows_frame([clean, fog | {"width": 10}]))
    assert (summary.epe_clean, summary.epe, summary.cre) == (7.0, 2.0, 1.0)
    assert (summary.clean.coverage, summary.coverage, summary.table("coverage")["1"].item()) == (1.0, 0.4, 0.4)
    assert has_gaps(summary)
    assert not has_gaps(summarize(rows_frame([clean])))


def test_families_average_their_corruptions():
    summary = summarize(rows_frame(THREE_IMAGES))
    assert list(summary.families) == ["weather"]
    assert summary.families["weather"].cre == 1.0
    assert summary.corruptions["fog"].family == "weather"
    for family, names in FAMILIES.items():
        rows = [row("a", epe=1.0)] + [row("a", name, 1, epe=1.0 + i) for i, name in enumerate(names)]
        assert summarize(rows_frame(rows)).families[family].epe == pytest.approx(1 + (len(names) - 1) / 2)


def test_missing_rows_are_listed_and_cre_is_over_the_same_images():
    partial = [r for r in THREE_IMAGES if (r["sample"], r["corruption"], r["severity"]) != ("a", "fog", 1)]
    summary = summarize(rows_frame(partial))
    assert not summary.complete
    assert [unit.model_dump() for unit in summary.missing] == [{"corruption": "fog", "severity": 1, "samples": ["a"]}]
    fog = summary.corruptions["fog"]
    assert fog.severities == [1, 2]
    assert fog.by_severity["epe"] == [9.5, 11.0]
    assert fog.by_severity["cre"] == [4.0, 7.0]


def test_a_missing_clean_row_is_listed():
    summary = summarize(
        rows_frame([row("a", epe=1.0), row("a", "fog", 1, epe=3.0), row("b", "fog", 1, epe=9.0, clean_epe_sum=10.0)])
    )
    assert [(unit.corruption, unit.samples) for unit in summary.missing] == [("clean", ["b"])]
    assert summary.cre == 2.0


def test_rows_are_missing_only_if_planned():
    rows = rows_frame(THREE_IMAGES)
    planned = list(rows.select("sample", "corruption", "severity").iter_rows())
    assert summarize(rows, planned=planned).complete
    summary = summarize(rows, planned=[*planned, ("b", "snow", 2), ("a", "snow", 2), ("d", "clean", 0)])
    assert [(unit.corruption, unit.severity, unit.samples) for unit in summary.missing] == [
        ("clean", 0, ["d"]),
        ("snow", 2, ["a", "b"]),
    ]
    assert summary.epe == summarize(rows).epe


def test_rows_without_a_pixel_to_measure_are_listed_not_averaged():
    without_flow = row("b", "fog", 1, n=0, n_all=0, n_invalid=60)
    summary = summarize(rows_frame([row("a", epe=1.0), row("b", epe=3.0), row("a", "fog", 1, epe=2.0), without_flow]))
    assert not summary.complete
    assert summary.n_invalid == 60
    assert [(unit.corruption, unit.samples) for unit in summary.unmeasured] == [("fog", ["b"])]
    assert (summary.epe, summary.cre, summary.epe_clean) == (2.0, 1.0, 2.0)


def test_without_ground_truth_rcre_is_over_all_pixels_and_the_rest_is_none():
    rows = [row("a", **NO_TRUTH), row("a", "fog", 1, n=10, **NO_TRUTH | {"rcre_all_sum": 40.0})]
    summary = summarize(rows_frame(rows))
    assert summary.complete
    assert (summary.rcre, summary.rcre_all) == (2.0, 2.0)
    assert {getattr(summary, m) for m in METRICS if not m.startswith(("rcre", "coverage"))} == {None}
    assert summary.coverage == 1.0
    assert (summary.epe_clean, summary.regions) == (None, {})


@pytest.mark.parametrize(("averaging", "length"), [("image", (2.0 + 5.0) / 2), ("pixel", (200.0 + 50.0) / 110)])
def test_clean_flow_length_is_over_predicted_pixels_of_clean_rows(averaging, length):
    rows = [row("a", n_all=100, pred_magnitude_sum=200.0), row("a", "fog", 1, pred_magnitude_sum=9000.0)]
    rows += [row("b", n_all=10, pred_magnitude_sum=50.0), row("c", n_all=0)]
    assert summarize(rows_frame(rows), averaging).clean_flow_length == pytest.approx(length, rel=1e-12)


def test_a_perfect_clean_flow_has_no_crer():
    summary = summarize(rows_frame([row("a", epe=0.0), row("a", "fog", 1, epe=2.0)]))
    assert (summary.cre, summary.crer) == (2.0, None)


def test_empty_rows_have_no_means():
    summary = summarize(rows_frame([]))
    assert (summary.epe, summary.epe_clean, summary.samples, summary.corruptions) == (None, None, 0, {})


def test_duplicate_rows_and_tables_of_a_different_schema_are_refused():
    with pytest.raises(RunError, match="sample 'b', fog severity 2 occur twice"):
        summarize(rows_frame([*THREE_IMAGES, THREE_IMAGES[7]]))
    with pytest.raises(RunError, match="lack the column 'n_all'"):
        summarize(rows_frame(THREE_IMAGES).drop("n_all"))
    with pytest.raises(UsageError, match="choose from image, pixel"):
        summarize(rows_frame(THREE_IMAGES), "pixels")  # type: ignore[arg-type]


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
def test_neither_the_order_of_rows_nor_reading_a_column_at_a_time_changes_a_byte(rows, averaging, rng: random.Random):
    shuffled = rng.sample(rows, len(rows))
    expected = summarize(rows_frame(rows), averaging).model_dump_json(indent=1)
    halves = pl.concat([rows_frame(shuffled[::2]), rows_frame(shuffled[1::2])])
    assert summarize(halves, averaging).model_dump_json(indent=1) == expected
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("robustflow.run.aggregate._FEW_ROWS", -1)
        assert summarize(rows_frame(shuffled).lazy(), averaging).model_dump_json(indent=1) == expected


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


def _mean(*values):
    known = [value for value in values if value is not None]
    return pytest.approx(fmean(known), rel=1e-9, abs=1e-6) if known else None


@settings(max_examples=40)
@given(runs(), st.sampled_from(["image", "pixel"]))
def test_means_equal_the_naive_loop(rows, averaging):
    summary = summarize(rows_frame(rows), averaging)
    expected = _naive_scores(rows, averaging)
    inside = _naive_scores(rows, averaging, "epe_sum_occ", "rcre_sum_occ", "n_occ")
    assert summary.epe_clean == _mean(expected.get(("clean", 0), {}).get("epe"))
    occ = summary.regions.get("occ")
    if occ is not None:
        assert occ.epe_clean == _mean(inside.get(("clean", 0), {}).get("epe"))
    for metric in ("epe", "cre", "rcre"):
        for name, scores in summary.corruptions.items():
            values = [expected[name, severity][metric] for severity in scores.severities]
            assert scores.by_severity[metric] == [_mean(value) for value in values]
            assert getattr(scores, metric) == _mean(*values)
        parts = [getattr(summary.corruptions[name], metric) for name in summary.averaged_over]
        assert getattr(summary, metric) == _mean(*parts)
        if occ is not None:
            each = [[inside[key][metric] for key in inside if key[0] == name] for name in summary.averaged_over]
            means = [fmean(known) for values in each if (known := [value for value in values if value is not None])]
            assert getattr(occ, metric) == _mean(*means)
