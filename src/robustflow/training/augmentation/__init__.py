"""Augment training pairs, dense and sparse, as in RAFT: parameters are drawn first, then applied."""
