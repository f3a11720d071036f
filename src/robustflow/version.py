"""The version of the package, the one that `pyproject.toml` builds."""

VERSION = "0.1.0"
