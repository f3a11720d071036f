"""No public name, parameter, command or option disappears unnoticed, because users' scripts refer to them."""

from .public_surface import STORED, surface, without_torch

KNOWN = set(STORED.read_text(encoding="utf-8").splitlines())


def test_nothing_disappears():
    assert not sorted(KNOWN - set(surface()) - set(without_torch())), (
        "gone, or changed: these lines of tests/public_surface.txt"
    )


def test_what_is_new_is_written_down():
    assert not sorted(set(surface()) - KNOWN), "python -m tests.rewrite"
