"""Train flow networks with the recipes of the paper and of the original authors. Requires the `torch` extra."""
