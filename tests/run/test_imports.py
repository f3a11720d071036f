"""Test what a run imports before it needs it."""

import subprocess
import sys

_RUN = """
import sys
import robustflow.api
from robustflow.run.setup import open_benchmark, set_up
from robustflow.run.worker import Worker

plan = set_up("dis", open_benchmark("demo").narrowed(["contrast"], [1]))
worker = Worker(plan.job())
rows = [worker.run(unit) for unit in plan.units()]
assert len(rows) == 2
for name in sorted(sys.modules):
    print(name)
"""


def test_run_without_attacks_imports_no_attack_no_figure_and_no_video():
    ran = subprocess.run([sys.executable, "-c", _RUN], capture_output=True, text=True, check=True)
    imported = set(ran.stdout.split())
    assert "robustflow.run.worker" in imported
    assert not imported & {"matplotlib", "jinja2", "av", "robustflow.report", "robustflow.run.attack_stage"}
    attacks = {name for name in imported if name.startswith("robustflow.attacks.")}
    assert attacks == {"robustflow.attacks.registry"}, "only the names of attacks are needed"
