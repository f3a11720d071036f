"""A run's folder is a cache: what a call returns does not depend on what earlier calls wrote into its folder."""

import json
import signal
from functools import cache
from tempfile import TemporaryDirectory

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import robustflow as rf
from robustflow.cli.tables import as_json_text
from robustflow.data.benchmarks import Benchmark
from robustflow.run.manifest import UNEVEN, Cells, union
from robustflow.run.records.pack import record_bytes
from robustflow.run.records.read import Reader
from robustflow.run.records.verify import verify_read
from robustflow.testing import BrightnessFlow, TexturePairs

KEYS = ("0", "1", "2")
CALLS = st.fixed_dictionaries(
    {
        "corruptions": st.sampled_from(
            [["contrast"], ["high_light"], ["contrast", "high_light"], ["contrast:2", "fog"]]
        ),
        "severities": st.sampled_from([[1], [3], [1, 2], [2, 3]]),
        "limit": st.sampled_from([1, 2, None]),
    },
    optional={"attacks": st.just("random_sign")},
)


def _call(folder, options):
    benchmark = Benchmark("drawn", TexturePairs(3, (24, 32)), KEYS, ("contrast",), (1, 2))
    return rf.evaluate(BrightnessFlow(), benchmark, output=folder, **options)


def _result_facts(result):
    """Everything that a call says about its rows, without the folder and the time."""
    (document,) = json.loads(as_json_text([result]))
    if "attacks" in document:
        document["attacks"] = [row for row in document["attacks"] if row["measure"] != "attack_seconds"]
    del document["folder"]
    rows = [frame.write_csv() for frame in (result.rows, result.attack_rows, result.table("cre"))]
    text = str(result).replace(str(result.path), "")
    means = result.means, result.measured
    return document, means, rows, text, result.left_out, result.planned(), result.manifest.samples


@cache
def _alone(options):
    with TemporaryDirectory() as folder:
        return _result_facts(_call(folder, json.loads(options)))


@settings(max_examples=8, deadline=None)
@given(st.lists(CALLS, min_size=2, max_size=4))
def test_calls_into_a_shared_folder_give_the_result_of_an_empty_one(calls):
    with TemporaryDirectory() as folder:
        results = [_call(folder, options) for options in calls]
        for result, options in zip(results, calls, strict=True):
            assert _result_facts(result) == _alone(json.dumps(options))
        whole = rf.load_run(folder)
        assert whole.measured.complete
        assert set(whole.planned()) == {cell for result in results for cell in result.planned()}
        assert whole.rows.height == len(whole.planned())
        assert whole.write_means() is None
        assert verify_read(Reader(record_bytes(whole), "record")).ok
        assert json.loads((whole.path / "summary.json").read_text())["epe"] == whole.epe


@given(
    st.lists(
        st.builds(
            Cells,
            samples=st.sets(st.sampled_from("abcd")).map(lambda keys: tuple(sorted(keys))),
            corruptions=st.dictionaries(st.sampled_from(["fog", "snow"]), st.sampled_from([(1,), (2,), (1, 2)])),
            attacks=st.dictionaries(st.sampled_from(["square"]), st.sampled_from([(1,), (1, 2)])),
        )
    )
)
def test_a_union_has_the_cells_of_its_parts_and_every_sample_once(parts):
    def cells(every):
        return {cell for part in every for cell in (*part.corrupted(), *part.attacked())}

    whole = union(parts)
    assert cells(whole) == cells(parts)
    assert sum(part.count() for part in whole) == len(cells(parts))
    keys = [key for part in whole for key in part.samples]
    assert len(keys) == len(set(keys))
    conditions = [(frozenset(part.corruptions.items()), frozenset(part.attacks.items())) for part in whole]
    assert len(conditions) == len(set(conditions))
    assert cells(union([*whole, *parts])) == cells(whole)
    assert union(whole) == whole


ONE = ("run", "--model", "dis", "-c", "fog", "-s", "3", "-o", "run")
OTHER = ("run", "--model", "dis", "-c", "contrast", "-s", "1", "-o", "run")


@pytest.mark.usefixtures("demo_is_small")
def test_a_mean_over_unlike_conditions_is_marked_wherever_a_folder_is_read(robustflow, tmp_path, real_pictures):
    page = tmp_path / "run" / "report.html"
    with real_pictures():
        assert UNEVEN not in robustflow.prints(*ONE) + page.read_text()
        assert UNEVEN not in robustflow.prints(*OTHER)
    assert UNEVEN in page.read_text()
    assert UNEVEN in str(rf.load_run("run"))
    robustflow.prints("record", "pack", "run", "-o", "run.robustflow")
    for command in (("report", "run"), ("record", "verify", "run.robustflow")):
        assert UNEVEN in robustflow.prints(*command)
    robustflow.prints("export", "run", "--format", "huggingface", "--hub-dataset", "someone/demo")
    assert UNEVEN in (tmp_path / "huggingface" / ".eval_results" / "robustflow.yaml").read_text()


def test_an_earlier_result_stays_as_it_was_when_a_later_call_adds_rows(tmp_path):
    first = _call(tmp_path, {"corruptions": "contrast", "severities": 3})
    _call(tmp_path, {"corruptions": "high_light", "severities": 1})
    assert first.measured.averaged_over == ["contrast"]
    assert first.rows["corruption"].unique().sort().to_list() == ["clean", "contrast"]
    first.write_summary()
    first.keep()
    assert rf.load_run(tmp_path).measured.averaged_over == ["contrast", "high_light"]
    assert json.loads((tmp_path / "summary.json").read_text())["averaged_over"] == ["contrast", "high_light"]


def test_a_call_is_complete_while_the_cells_of_a_stopped_call_are_missing(tmp_path, monkeypatch):
    class Stops(BrightnessFlow):
        name = "stops"
        left = 2

        def predict(self, frame1, frame2):
            if not self.left:
                raise KeyboardInterrupt
            self.left -= 1
            return super().predict(frame1, frame2)

    monkeypatch.setattr(signal, "getsignal", lambda _: signal.default_int_handler)  # a background job ignores Ctrl-C
    benchmark = Benchmark("drawn", TexturePairs(3, (24, 32)), KEYS, ("contrast",), (1, 2))
    model = Stops()
    with pytest.raises(KeyboardInterrupt):
        rf.evaluate(model, benchmark, output=tmp_path)
    model.left = 100
    result = rf.evaluate(model, benchmark, output=tmp_path, corruptions="high_light", severities=1, limit=1)
    assert result.measured.complete
    whole = rf.load_run(tmp_path)
    missing = {condition for cells in whole.measured.missing for condition in cells.conditions}
    assert missing >= {("contrast", 1), ("contrast", 2)}
    assert ("high_light", 2) not in missing
