"""Every case in a pack becomes a test; the errors are listed at the end of the run."""

from __future__ import annotations

import sys

import pytest

from ..shared_data import shared_root

NO_CASE = "none"
"""If a pack has no case with this ending, or is missing, one test remains and skips with the reason."""


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """A test that takes `case` runs once for each case letter in the pack that its class or module names as PACK, with
    the file ending from the mark `expected` (`a_expected_ft.npz` is case a of the ending "_ft").
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
    """The pack that the test's class or module names as PACK."""
    pytest.importorskip("torch", reason="needs the torch extra")
    from .pack import Pack

    folder = shared(f"parity/{(request.cls or request.module).PACK}")
    if "case" in request.fixturenames and request.getfixturevalue("case") == NO_CASE:
        pytest.skip(f"the pack {folder.name} holds no case of this kind")
    return Pack(folder)


def pytest_terminal_summary(terminalreporter) -> None:
    report = getattr(sys.modules.get(f"{__package__}.pack"), "REPORT", [])
    if report:
        terminalreporter.section("parity with the original implementations")
        for line in dict.fromkeys(report):
            terminalreporter.write_line(line)
