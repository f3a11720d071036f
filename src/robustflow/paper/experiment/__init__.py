"""Experiments that train and evaluate networks, as commands that can be interrupted and resumed."""
