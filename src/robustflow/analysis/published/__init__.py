"""The paper's tables as they are printed."""
