"""Train flow networks by the recipes of the paper and of the originals. Needs the extra `torch`."""
