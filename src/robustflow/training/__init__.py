"""Train flow networks by the recipes of the paper and of the original authors. Needs the extra `torch`."""
