"""Network definitions with the state-dict keys of the authors' checkpoints. Every module here
requires the torch extra.
"""
