"""What was meant by a word that a command does not expect: a corruption among the models, a model among the files."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ..core.errors import UsageError

_PLACES = {
    "corruption": ("corruptions", "corruption"),
    "severity": ("severities", "severity"),
    "attack": ("attacks",),
    "benchmark": ("benchmark", "data"),
    "model": ("model", "model_list"),
    "recipe": ("recipe",),
    "file": ("data", "clip"),
}
"""Parameters of commands that take each kind of word, the best first."""
_ARGUMENTS = {"models": "model", "network": "model", "frames": "file", "runs": "file", "files": "file", "run": "file"}
_ARGUMENTS |= {"sources": "file", "frame1": "file", "frame2": "file", "what": "benchmark", "kind": "kind"}
"""The kind of word that is expected by each positional parameter for which other kinds are explained."""
_LISTS = ("corruption", "severity", "attack")
_INSTEAD = {
    "model": "robustflow run {}",
    "corruption": "robustflow run MODEL --corruptions {}",
    "attack": "robustflow run MODEL --attacks {}",
    "benchmark": "robustflow run MODEL --benchmark {}",
    "recipe": "robustflow train NETWORK --recipe {}",
    "severity": "robustflow run MODEL --severities {}",
    "file": "robustflow run MODEL --data {}",
}


def kind_of(word: str) -> str:
    """Return the kind of thing that a word names: "corruption", "model", "file", ...; "" if nothing has this name."""
    from ..attacks.registry import ATTACKS
    from ..corruptions.registry import CORRUPTIONS
    from ..data.benchmarks import BENCHMARKS
    from ..data.datasets import DATASETS
    from ..models.catalog import methods
    from ..models.registered import MODELS
    from ..training.recipe import recipes_of, trained_methods

    first = re.split(r"[,:+]", word)[0].lower()
    names_of: dict[str, Any] = {
        "corruption": {*CORRUPTIONS, *CORRUPTIONS.also},
        "attack": ATTACKS,
        "benchmark": {*BENCHMARKS, *DATASETS},
        "model": {*MODELS, *methods()},
        "recipe": {stage for method in trained_methods() for stage in recipes_of(method)},
    }
    if re.fullmatch(r"[1-5]([-,][1-5])*", word):
        return "severity"
    return next((kind for kind, names in names_of.items() if first in names), "file" if Path(word).exists() else "")


def advice(command: Any, word: str, expected: str = "", given: dict[str, Any] | None = None) -> UsageError | None:
    """Return the error that says how to give a word that a command does not expect; None if nothing has this name.

    Args:
        command: the click command.
        word: the word.
        expected: the kind of word that belongs there.
        given: values of the command's options by name.
    """
    kind = kind_of(word)
    if kind in ("", expected):
        return None
    if expected == "kind":
        if kind in ("severity", "file"):
            return None
        return UsageError(word, f"this is the name of one {kind}; write: robustflow list {kind}s")
    option = next((p for name in _PLACES[kind] for p in command.params if p.name == name), None)
    what = "a file or folder" if kind == "file" else f"the name of a {kind}".replace("a a", "an a")
    what = "a number" if kind == "severity" else what
    if option is None:
        instead = _INSTEAD[kind].format(word)
        return UsageError(word, f"this is {what}, which '{command.name}' does not take here; use it as in: {instead}")
    before = (given or {}).get(option.name)
    joined = f"{before},{word}" if kind in _LISTS and before else word
    several = "; commas separate several" if joined != word else ""
    return UsageError(word, f"this is {what}: write {option.opts[0]} {joined}{several}")


def explained(command: Any, error: Exception, given: dict[str, Any]) -> Exception:
    """Return the error of a command, or a better one: with the option in place of its parameter's name, or with what
    the word that is at fault meant."""
    culprit, options = getattr(error, "culprit", ""), {p.name: p.opts[0] for p in command.params if p.opts[0][0] == "-"}
    if culprit in options and error.args[0] == culprit:
        error.args = (options[culprit], *error.args[1:])
        vars(error)["culprit"] = options[culprit]
    for name, expected in _ARGUMENTS.items():
        words: Sequence[Any] = given.get(name) or ()
        words = words if isinstance(words, list | tuple) else (words,)
        if culprit and Path(culprit) in map(Path, words):
            return advice(command, culprit, expected, given) or error
    return error


def unknown_option(command: Any, option: str, commands: Any) -> UsageError | None:
    """Return the error for an option that a command does not have, but others do."""
    having = [name for name, other in commands.items() if any(option in p.opts for p in getattr(other, "params", ()))]
    there = f"'{command.name}' has no such option; it is an option of {', '.join(having)}"
    return UsageError(option, there) if having else None
