"""Losses of the recipes: supervised sequence loss, GMFlowNet's matching loss, and those without labels."""
