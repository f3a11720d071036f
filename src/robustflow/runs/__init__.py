"""What a run is: its plan, identity, manifest and rows, and what is stored with them."""
