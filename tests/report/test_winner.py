"""A flow that is too short has a larger error but a lower CRE, CREr and RCRE than the sound flow: it wins nothing."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

import robustflow as rf
from robustflow.models import load_model
from robustflow.report.cost_table import cost_table
from robustflow.report.site.content import whole_content
from robustflow.report.site.headline import headline
from robustflow.report.tables import build_table
from robustflow.run.run import Run

_PAIRS = 16


def _clipped(flow: np.ndarray) -> np.ndarray:
    length = np.linalg.norm(flow, axis=-1, keepdims=True)
    return np.where(length > 3, flow * (3 / np.maximum(length, 1)), flow).astype(np.float32)


class _Changed:
    """DIS with a changed flow."""

    def __init__(self, name: str, change: Callable[[np.ndarray], np.ndarray]) -> None:
        self._name, self._change, self._dis = name, change, load_model("dis")

    def predict(self, first: np.ndarray, second: np.ndarray) -> np.ndarray:
        return self._change(self._dis.predict(first, second))

    def identity(self) -> dict[str, str]:
        return {"name": self._name}


_MODELS = {
    "sound": lambda flow: flow,
    "x 0.9": lambda flow: np.float32(0.9) * flow,
    "x 0.6": lambda flow: np.float32(0.6) * flow,
    "clipped": _clipped,
}


@pytest.fixture(scope="module")
def models(tmp_path_factory) -> dict[str, Run]:
    """Runs of DIS and of DIS with shorter flows on the same 16 pairs. A flow of 0.6 times the length is accurate enough
    to be ranked."""
    options = {"corruptions": ["fog", "contrast", "gaussian_noise"], "severities": [3], "limit": _PAIRS}
    return {
        name: rf.evaluate(_Changed(name, change), "shapes", output=tmp_path_factory.mktemp("short"), **options)
        for name, change in _MODELS.items()
    }


@pytest.mark.parametrize("short", ["x 0.9", "x 0.6", "clipped"])
def test_model_with_a_shortened_flow_leads_no_page_and_has_no_bold_value(models, short):
    content = whole_content([models[short], models["sound"]], published=False)
    sound, other = (next(line for line in content.lines if line.name == name) for name in ("sound", short))
    for of in (("cre", "average"), ("rcre", "average")):
        assert other.number(*of) < sound.number(*of)
    assert [line.label for line in content.boards[0].lines] == ["sound", short]
    assert not any(cell.best for cell in content.cells[other].values())
    first = headline(content)[0]
    if other.excluded:
        assert first.startswith("sound on ")
    else:
        assert "the most robust is sound (" in first
        assert content.cells[sound]["epe", "average"].best
        assert content.cells[sound]["epe", "clean"].best


@pytest.mark.parametrize("name", ["epe", "cre", "rcre", "cost"])
def test_table_marks_no_shortened_flow(models, name):
    lines = whole_content([models["x 0.9"], models["sound"]], published=False).lines
    table = cost_table(lines) if name == "cost" else build_table(name, lines)
    marked = {line.label for line in table.lines if line.best or any(cell.best for cell in line.cells)}
    assert marked == ({"sound"} if name == "epe" else set())


def test_comparison_and_ranking_without_a_metric_follow_the_error(models):
    comparison = rf.compare(models["x 0.9"], models["sound"])
    assert comparison.metric == "epe"
    assert comparison.sentence.endswith("sound is more accurate.")
    cells = [line.cells for section in comparison.table().sections for line in section.lines]
    assert any(second.best for _, second, *_ in cells)
    assert not any(first.best for first, *_ in cells)
