"""The command line: one thin file per command.

The files of commands do without `from __future__ import annotations`: Typer reads the annotations of every option of
every command on every start, and evaluating them as text takes noticeable time.
"""
