"""Training without labels: what ARFlow, UPFlow and BrightFlow minimise."""
