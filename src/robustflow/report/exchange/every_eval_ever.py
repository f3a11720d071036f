"""Every Eval Ever: the EvalEval coalition's shared schema for evaluation results, version 0.3.0."""

from __future__ import annotations

from pathlib import PurePosixPath
from typing import Any
from uuid import UUID

from ...analysis.labels import METRIC_LABELS, UNITS
from ...analysis.uncertainty.bootstrap import LEVEL, RESAMPLES
from ...atomic import json_bytes
from ...digest import digest_of_value
from ...text import file_name
from .facts import RunFacts, RunMean

SCHEMA_VERSION = "0.3.0"
_UNKNOWN = "unknown"


def every_eval_ever_files(facts: RunFacts) -> dict[PurePosixPath, bytes]:
    """Return one file with its path in the collection: data/BENCHMARK/DEVELOPER/MODEL/UUID.json."""
    benchmark, model = file_name(facts.run.benchmark), file_name(facts.name)
    seconds = "0" if facts.finished is None else f"{facts.finished.timestamp():.0f}"
    content = {
        "schema_version": SCHEMA_VERSION,
        "evaluation_id": f"{benchmark}/{_UNKNOWN}_{model}/{facts.digest}",
        "evaluation_timestamp": seconds,
        "retrieved_timestamp": seconds,
        "source_metadata": {
            "source_name": "RobustFlow",
            "source_type": "evaluation_run",
            "source_organization_name": _UNKNOWN,
            "evaluator_relationship": "other",
            "additional_details": {"run": facts.digest, "warnings": " ".join(facts.warnings)},
        },
        "eval_library": {"name": "robustflow", "version": facts.version},
        "model_info": {
            "name": facts.name,
            "id": f"{_UNKNOWN}/{model}",
            "additional_details": {
                "deployment_type": "self_deployed",
                "model_availability": _UNKNOWN,
                "setting": facts.run.setting,
                **{f"option {name}": text for name, text in facts.settings.items()},
            },
        },
        "evaluation_results": [_result(facts, mean) for mean in facts.means],
    }
    unique = UUID(bytes=bytes.fromhex(digest_of_value(content, size=16)), version=4)
    return {PurePosixPath("data", benchmark, _UNKNOWN, model, f"{unique}.json"): json_bytes(content)}


def _result(facts: RunFacts, mean: RunMean) -> dict[str, Any]:
    data = facts.data
    score: dict[str, Any] = {"score": mean.value}
    if mean.interval is not None:
        low, high = mean.interval
        score["uncertainty"] = {
            "confidence_interval": {"lower": low, "upper": high, "confidence_level": LEVEL, "method": "bootstrap"},
            "num_samples": data["pairs"],
            "num_bootstrap_samples": RESAMPLES,
        }
    return {
        "evaluation_result_id": f"{mean.metric}.{mean.condition}",
        "evaluation_name": f"{facts.title}, {mean.condition}",
        "source_data": {
            "dataset_name": facts.title,
            "source_type": "other",
            "additional_details": {"pairs": str(data["pairs"]), "sample_set": data["sample_set"]},
        },
        "metric_config": {
            "evaluation_description": f"{METRIC_LABELS[mean.metric]} of optical flow, {mean.condition} frames",
            "metric_id": f"robustflow.{mean.metric}",
            "metric_name": METRIC_LABELS[mean.metric],
            "metric_unit": UNITS[mean.metric] or "ratio",
            "lower_is_better": True,
            "score_type": "continuous",
            "min_score": 0 if mean.metric in ("epe", "rcre") else "-Infinity",
            "max_score": "Infinity",
        },
        "score_details": score,
    }
