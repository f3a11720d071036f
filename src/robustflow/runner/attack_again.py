"""Repeat an attack of a finished run, loading only code and files that the user names."""

from __future__ import annotations

from collections.abc import Container
from dataclasses import replace

from ..attacks import load_attack
from ..attacks.own import own_attacks_among
from ..attacks.registry import split_name
from ..errors import RunError, UsageError
from ..models.loading import ModelSpec
from ..runs.run import Run
from ..runs.source import RunSource
from ..runs.store import RunFolder
from ..text import plain
from .attack_training import learned_pattern
from .setup import Setup


def with_attack(setup: Setup, run: Run, name: str, severity: int, named: Container[str] = ()) -> Setup:
    """Return the setup of a finished run, restricted to one of its attacks at one severity.

    Args:
        setup: setup of the run, from `restore_setup`.
        run: finished run that contains the attack.
        name: name of the attack in the run.
        severity: severity of the attack, 1 to 5.
        named: attacks named by the user; only these may load code and files.

    Raises:
        RunError: the attack names code or a file that the user did not name, its code or settings have changed, or its
            trained perturbation is missing.
    """
    if name not in named and _names_code_or_a_file(name):
        raise RunError(
            f"the run's attack '{plain(name)}' refers to code or a file, and code named in a run folder is never "
            f"loaded: pass --own-attack '{plain(name)}' yourself if you trust it"
        )
    plan, options = setup.plan, setup.options
    try:
        attack = load_attack(name).with_variant(options.variant)
    except UsageError as error:
        raise RunError(
            f"the run's attack '{plain(name)}' cannot be loaded ({plain(str(error), 200)}); if it is your own attack, "
            "pass it with --own-attack MODULE:ATTRIBUTE"
        ) from error
    learned = {}
    for label, (part, _) in attack.training(setup.model.model).items():
        pattern = learned_pattern(RunFolder(run.path), plan, label, severity, part)
        if pattern is None:
            raise RunError(f"{run.path} no longer has the trained attack {plain(label)}; repeat the run")
        learned[label] = {severity: pattern}
    sources = options.attack_sources.get(name, "").split()
    if sources[: len(sources) - len(learned)] != attack.source.split():
        raise RunError(f"the attack {plain(name)} has changed since {run.path} was run; repeat the run")
    options = replace(options, attacks=(name,), own_attacks=own_attacks_among([name]), learned=learned)
    return replace(setup, plan=replace(plan, options=options))


def _names_code_or_a_file(name: str) -> bool:
    head, argument, options = split_name(name)
    on = options.pop("on", argument if head == "transfer" else "tiny") or "tiny"
    options.pop("train", None)  # the trained perturbation is in the run folder
    try:
        RunSource(ModelSpec(on, tuple(options.items()))).model_to_reuse({})
    except RunError:
        return True
    return "file" in options
