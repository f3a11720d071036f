"""The parts of a run: its plan, identity, manifest and rows, and files stored with them."""
