"""What a model costs: parameters, multiply-accumulates, time and memory."""

from __future__ import annotations
