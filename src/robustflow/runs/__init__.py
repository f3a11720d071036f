"""What a run is: its plan, identity, manifest, rows, and what is kept beside them."""
