"""Network definitions with the same state-dict keys as the authors' checkpoints. All modules in this package require
the torch extra.
"""
