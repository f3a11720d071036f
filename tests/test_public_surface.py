"""No public name, parameter, command or option disappears unnoticed, because users' scripts refer to them."""

from .public_surface import STORED, surface, without_torch

KNOWN = set(STORED.read_text(encoding="utf-8").splitlines())


def test_no_public_name_disappears():
    assert not sorted(KNOWN - set(surface()) - set(without_torch())), (
        "gone, or changed: these lines of tests/public_surface.txt"
    )


def test_new_public_names_are_listed():
    assert not sorted(set(surface()) - KNOWN), "python -m tests.rewrite"
