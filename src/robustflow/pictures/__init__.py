"""Pictures of a run that need its model: example panels and any cell."""
