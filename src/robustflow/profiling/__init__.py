"""Measure the cost of a model: parameters, multiply-accumulates, time and memory."""

from __future__ import annotations
