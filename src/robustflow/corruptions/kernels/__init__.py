"""Compiled loops and filters shared by several corruptions."""
