"""The command line: one thin module per command.

Command modules do not use `from __future__ import annotations`: Typer evaluates the annotations of every option on
every start, and evaluating strings takes noticeable time.
"""
