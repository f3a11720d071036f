"""Test `robustflow app` when it cannot start; tests/app has all other cases."""

from robustflow import extras


def test_without_its_extra_it_says_how_to_get_it(robustflow, monkeypatch):
    monkeypatch.setattr(extras, "find_spec", lambda name: None)
    code, _, error = robustflow("app", "--no-browser")
    assert code == 1
    assert "pip install 'robustflow[app]'" in error
    assert error.count("\n") == 1
