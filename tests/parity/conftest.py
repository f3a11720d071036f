"""Create a test for every case in a parity pack; list the errors at the end of the test run."""

from __future__ import annotations

import sys

import pytest

from ..shared_data import shared_root

NO_CASE = "none"
"""Parameter of the single test that is created, and skipped with a reason, if a pack is missing or has no matching
case.
"""


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Run a test with the argument `case` once for each case letter in the pack given by PACK in the test's class or
    module. The mark `expected` sets the file ending (`a_expected_ft.npz` is case a with the ending "_ft").
    """
    if "case" not in metafunc.fixturenames:
        return
    marker = metafunc.definition.get_closest_marker("expected")
    suffix = marker.args[0] if marker else ""
    folder = shared_root() / "parity" / (metafunc.cls or metafunc.module).PACK
    ending = f"_expected{suffix}.npz"
    letters = sorted(path.name.removesuffix(ending) for path in folder.glob(f"*{ending}"))
    metafunc.parametrize("case", letters or [NO_CASE])


@pytest.fixture
def pack(request: pytest.FixtureRequest, shared):
    """The pack given by PACK in the test's class or module."""
    pytest.importorskip("torch", reason="needs the torch extra")
    from .pack import Pack

    folder = shared(f"parity/{(request.cls or request.module).PACK}")
    if "case" in request.fixturenames and request.getfixturevalue("case") == NO_CASE:
        pytest.skip(f"the pack {folder.name} has no case of this kind")
    return Pack(folder)


def pytest_terminal_summary(terminalreporter) -> None:
    report = getattr(sys.modules.get(f"{__package__}.pack"), "REPORT", [])
    if report:
        terminalreporter.section("parity with the original implementations")
        for line in dict.fromkeys(report):
            terminalreporter.write_line(line)
