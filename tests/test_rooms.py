"""A folder whose tests all skip, or are not collected, is reported."""

import os
import subprocess
import sys

import pytest

from .rooms import silent_folders

TESTS = {
    "attacks": 'import pytest\npytest.importorskip("no_such_library")\ndef test_a(): pass\n',
    "models": 'import pytest\ndef test_a(): pass\ndef test_b(): pytest.skip("no device")\n',
    "parity": "import pytest\ndef test_a(): pytest.skip(\"shared data 'parity/x' not found\")\n",
    "training": "import pytest\n@pytest.mark.slow\ndef test_a(): pass\n",
}


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    folder = tmp_path_factory.mktemp("rooms")
    for room, content in TESTS.items():
        (folder / "tests" / room).mkdir(parents=True)
        (folder / "tests" / room / f"test_{room}.py").write_text(content)
    (folder / "pytest.ini").write_text("[pytest]\nmarkers = slow\n")
    command = (
        sys.executable,
        "-m",
        "pytest",
        "-q",
        "-m",
        "not slow",
        "-p",
        "no:cacheprovider",
        "--junitxml=report.xml",
    )
    subprocess.run(command, cwd=folder, env={**os.environ, "PYTEST_ADDOPTS": ""}, check=True, capture_output=True)
    return folder / "report.xml"


@pytest.mark.parametrize(
    ("shared_exists", "silent"), [(True, ["attacks", "parity", "training"]), (False, ["attacks", "training"])]
)
def test_folder_without_a_run_test_is_reported_unless_shared_data_are_absent(
    report, monkeypatch, tmp_path, shared_exists, silent
):
    monkeypatch.setenv("ROBUSTFLOW_SHARED", str(tmp_path if shared_exists else tmp_path / "absent"))
    found = silent_folders(report, [f"tests/{room}" for room in TESTS])
    assert [line.partition(":")[0] for line in found] == [f"tests/{room}" for room in silent]
