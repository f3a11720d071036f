"""Metrics: from flows to sums, from sums to rows, from rows to means."""
