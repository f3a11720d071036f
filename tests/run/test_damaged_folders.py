"""Whatever is damaged in a run folder, no number changes: what can be read is what was measured, else one line says
what is damaged.
"""

import random
import re
import shutil
from collections import Counter

import pytest

import robustflow as rf
from robustflow.core.errors import RobustFlowError
from robustflow.run.records.pack import record_bytes
from robustflow.run.run import Run

CELLS = {"corruptions": ["contrast", "fog"], "severities": [1, 2]}
READ = {"rows": lambda run: run.rows.to_dicts(), "means": lambda run: dict(run.means), "record": record_bytes}


def _spoilt(data, kind, draw, other):
    """Return damaged content; None for a file that is to be deleted."""
    at, end = sorted(draw.choices(range(len(data) + 1), k=2))
    noise = draw.randbytes(draw.randrange(1, 200))
    match kind:
        case "bit":
            at = draw.randrange(len(data))
            return data[:at] + bytes([data[at] ^ 1 << draw.randrange(8)]) + data[at + 1 :]
        case "number":
            found = draw.choice([*re.finditer(rb"\d+", data)])
            return data[: found.start()] + b"%d" % draw.randrange(10 ** draw.randrange(1, 19)) + data[found.end() :]
    kinds = {
        "cut": data[:at],
        "zeros": data[:at] + bytes(len(data) - at),
        "hole": data[:at] + data[end:],
        "noise": data[:at] + noise + data[end:],
        "appended": data + noise,
        "empty": b"",
        "other file": other,
    }
    return kinds.get(kind)


KINDS = ("bit", "number", "cut", "zeros", "hole", "noise", "appended", "empty", "other file", "deleted")


@pytest.mark.slow
def test_no_damage_of_a_run_folder_changes_a_number(tmp_path):
    whole = rf.evaluate("farneback", output=tmp_path / "run", examples=False, **CELLS).path
    measured = {name: read(Run(whole)) for name, read in READ.items()}
    files = [path.relative_to(whole) for path in sorted(whole.rglob("*")) if path.is_file() and path.name != ".lock"]
    draw, outcomes, messages = random.Random(0), Counter(), []
    for number in range(500):
        folder = tmp_path / "damaged"
        shutil.copytree(whole, folder)
        place, kind = draw.choice(files), draw.choice(KINDS)
        content = _spoilt((whole / place).read_bytes(), kind, draw, (whole / draw.choice(files)).read_bytes())
        (folder / place).unlink() if content is None else (folder / place).write_bytes(content)
        rows_lost = kind == "deleted" and place.parts[0] == "rows"  # known to be missing, so not a damage
        for name, read in READ.items():
            try:
                outcomes["read" if rows_lost or read(Run(folder)) == measured[name] else "changed"] += 1
            except RobustFlowError as error:
                outcomes["refused"] += 1
                messages.append(str(error))
        if number % 25 == 0 and not rows_lost:
            try:
                again = rf.evaluate("farneback", output=folder, examples=False, **CELLS)
                assert again.rows.to_dicts() == measured["rows"]
            except RobustFlowError as error:
                messages.append(str(error))
        shutil.rmtree(folder)
    assert outcomes["changed"] == 0
    assert not [message for message in messages if "\n" in message]
    assert min(outcomes["read"], outcomes["refused"]) > 200, outcomes
