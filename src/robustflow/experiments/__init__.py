"""Experiments that train networks and measure them, as commands that can be stopped and continued."""
