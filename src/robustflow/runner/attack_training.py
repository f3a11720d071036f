"""Train the attacks of a run that need training, once per run, on samples that the run does not measure. The results
are stored in the run folder."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from ..attacks import Attack, load_attack
from ..attacks.api import pair_of_sample
from ..attacks.base import Learned, Pattern
from ..attacks.trained import Trained
from ..benchmarks import Benchmark
from ..datasets.split import read_split
from ..digest import digest_of_value
from ..errors import UsageError
from ..models.base import AnyModel, predict_checked
from ..random.rng import Rng, key_of
from ..runs.file_digests import file_digests
from ..runs.plan import Plan, Unit
from ..runs.sealed_array import read_array, write_array
from ..runs.store import RunFolder


def attacks_in_run(names: Iterable[str], variant: str) -> dict[str, Attack]:
    """Return the attacks of a run by name, in the run's variant if available."""
    return {name: load_attack(name).with_variant(variant) for name in names}


def training_keys(attack: Attack, benchmark: Benchmark, seed: int) -> tuple[str, ...]:
    """Return the training samples of an attack, none of which is measured."""
    every, measured = benchmark.dataset.keys(), set(benchmark.keys)
    if attack.trains.isdecimal():
        left = [key for key in every if key not in measured]
        if len(left) < int(attack.trains):
            raise UsageError(
                f"attack {attack.label} needs {attack.trains} training samples that are not measured, but only "
                f"{len(left)} are available; measure fewer with --limit or --split, or train on fewer"
            )
        return tuple(sorted(left, key=lambda key: (key_of("attack training", seed, key), key))[: int(attack.trains)])
    keys = read_split(attack.trains, every)
    if both := [key for key in keys if key in measured]:
        raise UsageError(
            f"attack {attack.label} would be trained on sample '{both[0]}', which this run measures ({len(both)} such "
            "samples in total); remove these samples from the file, or measure different ones with --split"
        )
    return tuple(keys)


def training_digest(attack: Attack, benchmark: Benchmark, seed: int) -> str:
    """Return a digest of an attack's training samples and their files."""
    keys = training_keys(attack, benchmark, seed)
    digests = file_digests({key: benchmark.dataset.files(key) for key in keys})
    return digest_of_value([list(keys), digests])


def learned_patterns(folder: RunFolder, plan: Plan, model: AnyModel, units: Sequence[Unit], batch_size: int) -> Learned:
    """Return the trained perturbations that the given units need. Each one is read from the run folder and verified
    against its digest, or else trained in batches of `batch_size` pairs and stored there.
    """
    options = plan.options
    attacks = attacks_in_run(options.attacks, options.variant)
    trained = {name: one.training(model) for name, one in attacks.items()}
    learned: dict[str, dict[int, Pattern]] = {}
    for name, severity in sorted({(unit.corruption, level) for unit in units for level in unit.severities}):
        for label, (attack, on) in trained.get(name, {}).items():
            pattern = _stored_pattern(folder, plan, label, severity, attack)
            if pattern is None:
                pattern = _trained(attack, plan, on, severity, batch_size)
                path = folder.pattern_path(label, severity)
                path.parent.mkdir(exist_ok=True)
                write_array(path, pattern, _pattern_key(plan, label, severity))
            learned.setdefault(label, {})[severity] = pattern
    return learned


def _stored_pattern(folder: RunFolder, plan: Plan, label: str, severity: int, attack: Attack) -> Pattern | None:
    """Return a trained perturbation by its label in `Attack.training`; None if it is damaged or missing from the run
    folder."""
    assert isinstance(attack, Trained)
    pattern = read_array(folder.pattern_path(label, severity), _pattern_key(plan, label, severity))
    return pattern if pattern is not None and attack.fits(pattern) and np.isfinite(pattern).all() else None


def _pattern_key(plan: Plan, label: str, severity: int) -> str:
    return f"{plan.digest()} {label} {severity}"


def _trained(attack: Attack, plan: Plan, model: AnyModel, severity: int, batch_size: int) -> Pattern:
    assert isinstance(attack, Trained)
    options, benchmark = plan.options, plan.benchmark
    pairs = []
    for key in training_keys(attack, benchmark, options.seed):
        pair = pair_of_sample(attack, benchmark.dataset.load(key), severity, options.seed)
        pairs.append((pair, predict_checked(model, pair.frames, key, "clean", 0)))  # type: ignore[arg-type]
    rng = Rng.of(options.seed, "attack training", attack.name, severity)
    return attack.learn(model, pairs, rng, batch_size)
