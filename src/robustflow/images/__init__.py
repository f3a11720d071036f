"""Pictures in and out, and what is drawn into them: flow colours, error colours."""
