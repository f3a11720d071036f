"""Augment dense and sparse training pairs as in RAFT: parameters are drawn first, then applied."""
