"""The parts of a run: its plan, identity, manifest and rows, and the files stored with them."""
