"""RobustFlow: how robust is an optical-flow model to image corruptions?"""

from __future__ import annotations

__version__ = "0.1.0"
