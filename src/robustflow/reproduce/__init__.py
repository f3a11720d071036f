"""The paper's tables and figures again: which of its models can run here, and ours beside the published values."""

from __future__ import annotations
