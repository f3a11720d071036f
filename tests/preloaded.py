"""What worker processes need, imported and loaded once; see `prepared_processes`."""

import pytest  # noqa: F401  # a worker imports the main module of its parent

import robustflow.run.engines.device
import robustflow.run.engines.processes  # noqa: F401
from robustflow.metrics.regions import Regions
from robustflow.testing import BrightnessFlow, TexturePairs  # noqa: F401

Regions.of(TexturePairs(1).load("0"))  # loads compiled code
