"""Benchmarks: the fixed samples, corruptions and severities that make results comparable."""

from __future__ import annotations

from .benchmark import Benchmark
from .facts import BenchmarkFacts
from .registry import BENCHMARKS, benchmark_facts, load_benchmark, outside_remark

__all__ = ["BENCHMARKS", "Benchmark", "BenchmarkFacts", "benchmark_facts", "load_benchmark", "outside_remark"]
