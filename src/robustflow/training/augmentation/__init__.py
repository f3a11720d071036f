"""Augmentation of training pairs, dense and sparse, as in RAFT: first drawn, then applied."""
