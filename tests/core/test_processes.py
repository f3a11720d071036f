"""Children start wherever Python does, and import the modules of their parent."""

import multiprocessing
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest

import robustflow
from robustflow.core.errors import UsageError
from robustflow.core.processes import in_child

from ..run.processes import is_running, wait_until

START = """
import os, sys
sys.path[:0] = sys.argv[1:]
import robustflow, robustflow.run.engines.processes
from robustflow.core.processes import Child

def where(pipe):
    pipe.send(("file", robustflow.__file__))

def start():
    child = Child(where)
    print(child.receive("start", "", "")[1], flush=True)
    child.end()

if __name__ == "__main__":
    start()
    if os.fork() == 0:
        start()
        os._exit(0)
    os.wait()
"""


def files_of_children(tmp_path: Path, *paths: str, temporary: Path | None = None) -> list[str]:
    script = tmp_path / "script.py"
    script.write_text(START)
    environment = os.environ | ({} if temporary is None else {"TMPDIR": str(temporary)})
    command = [sys.executable, "-W", "ignore::DeprecationWarning", str(script), *paths]  # Python 3.12 warns of forks
    run = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60)
    assert not run.stderr
    return run.stdout.split()


@pytest.mark.parametrize("long", [False, True])
def test_child_starts_with_a_long_temporary_folder_and_in_a_forked_process(tmp_path, long):
    temporary = tmp_path / ("t" * 110)
    temporary.mkdir()
    assert files_of_children(tmp_path, temporary=temporary if long else None) == [robustflow.__file__] * 2
    assert not [*temporary.iterdir()]


def test_child_imports_from_the_path_that_its_parent_has_changed(tmp_path):
    package = tmp_path / "elsewhere" / "robustflow"
    package.parent.mkdir()
    package.symlink_to(Path(robustflow.__file__).parent)
    assert files_of_children(tmp_path, str(package.parent)) == [str(package / "__init__.py")] * 2


def test_script_on_standard_input_can_have_children():
    script = 'from robustflow.core.processes import in_child\nprint(*in_child("a count", range, 3))'
    run = subprocess.run([sys.executable, "-"], input=script, capture_output=True, text=True, timeout=60)
    assert run.stdout.split() == ["0", "1", "2"], run.stderr


ENVIRONMENT = """
import os
from robustflow.core.processes import Child

VALUE = os.environ.get("VALUE")

def value(pipe):
    pipe.send(("value", VALUE))

if __name__ == "__main__":
    for os.environ["VALUE"] in "12":
        child = Child(value)
        print(child.receive("start", "", "")[1])
        child.end()
"""


def test_script_in_a_child_sees_the_environment_when_the_child_starts(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(ENVIRONMENT)
    run = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, timeout=60)
    assert run.stdout.split() == ["1", "2"]


INTERRUPTED = """
import os, signal, threading
import robustflow.run.engines.processes
from robustflow.core.processes import Child

def wait(pipe):
    pipe.recv()

if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.default_int_handler)
    threading.Timer(0.1, os.kill, (os.getpid(), signal.SIGINT)).start()
    Child(wait)
    threading.Event().wait()
"""


def test_ctrl_c_while_a_child_starts_ends_the_program(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(INTERRUPTED)
    run = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, timeout=60)
    assert run.stderr.endswith("KeyboardInterrupt\n")


DYING = """
import sys
from robustflow.core.processes import Child, preload

preload("dying")
if __name__ == "__main__":
    Child(print)
"""


def test_death_of_the_process_that_forks_children_is_an_error(tmp_path):
    (tmp_path / "dying.py").write_text("import os\nos._exit(1)\n")
    (tmp_path / "script.py").write_text(DYING)
    run = subprocess.run([sys.executable, str(tmp_path / "script.py")], capture_output=True, text=True, timeout=60)
    assert run.stderr.splitlines()[-1].startswith("robustflow.core.errors.RunError: "), run.stderr


def count_down(start: int):
    while start:
        yield start
        start -= 1
    raise UsageError("the count", "is over")


def test_steps_of_a_child_arrive_in_order_with_its_error():
    steps = in_child("a count", count_down, 3)
    assert [next(steps) for _ in range(3)] == [3, 2, 1]
    with pytest.raises(UsageError) as refused:
        next(steps)
    assert refused.value.culprit == "the count"
    assert not multiprocessing.active_children()


HANGING = """
import os, re, signal, sys, time
import robustflow.run.engines.processes
from robustflow.core.processes import Child

def hang(pipe, how):
    pipe.send(("at", os.getpid()))
    if how == "holds the lock":
        re.match(r"(a+)+$", "a" * 60 + "b")
    elif how == "stopped":
        os.kill(os.getpid(), signal.SIGSTOP)
    time.sleep(600)

if __name__ == "__main__":
    child = Child(hang, sys.argv[1])
    print(child.receive("start", "", "")[1], flush=True)
    time.sleep(600)
"""


@pytest.mark.parametrize("how", ["sleeps", "holds the lock", "stopped"])
def test_a_hanging_child_ends_when_its_parent_is_killed(tmp_path, how):
    script = tmp_path / "script.py"
    script.write_text(HANGING)
    parent = subprocess.Popen([sys.executable, str(script), how], stdout=subprocess.PIPE, text=True)
    child = int(parent.stdout.readline())
    time.sleep(0.5)  # let it hang
    parent.kill()
    parent.wait()
    try:
        wait_until(lambda: not is_running(child), within_s=10)
    finally:
        if is_running(child):
            os.kill(child, signal.SIGKILL)


def test_the_files_of_a_killed_process_are_removed_by_the_next_one_and_those_of_a_living_one_are_not(tmp_path, request):
    script = tmp_path / "script.py"
    script.write_text(HANGING)
    temporary = Path(tempfile.mkdtemp(dir="/tmp"))  # no socket can have a long path
    request.addfinalizer(lambda: shutil.rmtree(temporary))

    def start() -> subprocess.Popen[str]:
        command, environment = [sys.executable, str(script), "sleeps"], os.environ | {"TMPDIR": str(temporary)}
        process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment)
        assert process.stdout.readline()
        return process

    living = start()
    (used,) = temporary.iterdir()
    killed = start()
    (abandoned,) = {*temporary.iterdir()} - {used}
    killed.kill()
    killed.wait()
    assert abandoned.is_dir()
    # the process that forks holds the folder until it has noticed the end of its parent
    wait_until(lambda: files_of_children(tmp_path, temporary=temporary) and [*temporary.iterdir()] == [used])
    living.kill()
    living.wait()
