"""The paper's tables as printed."""
