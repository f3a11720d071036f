"""Training without labels: the objectives of ARFlow, UPFlow and BrightFlow."""
