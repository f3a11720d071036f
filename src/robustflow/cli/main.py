"""The `robustflow` command: subcommands and error output."""

import ast
import inspect
import io
import math
import os
import sys
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from importlib import import_module
from pathlib import Path
from typing import Any

import typer
from typer.core import TyperCommand, TyperGroup, TyperOption

from .. import __version__
from ..core.display import ignore_local_settings
from ..core.environment import SAFE_PATH
from ..core.errors import RobustFlowError, UsageError, class_and_message, options_named, plain_warning
from ..core.output import results_only
from ..core.paths import user_path
from ..core.text import is_utf8, plain
from .advice import advice, explained, unknown_option

_PANELS = {
    "Measure": ("run", "predict", "profile"),
    "Look": ("report", "gallery"),
    "Compare and share": ("compare", "leaderboard", "record"),
    "Train": ("train",),
    "The paper": ("reproduce",),
    "Make": ("corrupt", "export", "prepare", "optics"),
    "More": ("app", "list", "check"),
}
"""Commands by heading in `--help`, each in the module of its name. Under each heading, groups come after single
commands, as in Typer's output."""

_GROUPS = {
    "record": "Pack a run into one file, and verify such files.",
    "reproduce": "Reproduce the paper: a table or figure (reproduce tab2), its audit, its observations.",
    "prepare": "Prepare a benchmark's data from recordings, or list the digests of a dataset.",
    "optics": "Design, show and render the lenses of psf_blur.",
}


_LEAST_MEMORY = 2_500_000_000
"""Address space of a process that computes a row with the smallest model, in bytes."""


def command_line(arguments: Sequence[str] | None = None) -> typer.Typer:
    """Build the command line; with `arguments`, only with the commands that they name. If they name none, all commands
    are listed, without options and without importing them, so that `--help` is fast."""
    app = typer.Typer(
        name="robustflow",
        cls=_Commands,
        help="How robust is an optical-flow model to image corruptions?",
        epilog="Start with: robustflow run --model dis",
        no_args_is_help=True,
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": ["-h", "--help"]},
    )
    app.callback()(_options)
    every = [(panel, name) for panel, commands in _PANELS.items() for name in commands]
    named = [(panel, name) for panel, name in every if arguments is None or name in arguments]
    for panel, name in named or every:
        if name in _GROUPS:
            group = _command(name) if named else typer.Typer()
            for command in group.registered_commands:
                command.cls = _Command
            app.add_typer(group, name=name, help=_GROUPS[name], rich_help_panel=panel)
        else:
            app.command(name, cls=_Command, rich_help_panel=panel)(_command(name) if named else _listed(name))
    return app


def _module(name: str) -> str:
    return "listing" if name == "list" else name


def _command(name: str) -> Any:
    """Return the function or group of a command, named as its module."""
    module = import_module(f".{_module(name)}", __package__)
    return getattr(module, "app" if name in _GROUPS else _module(name))


class _Command(TyperCommand):
    """A command that refuses an option given twice, an empty value or list, and bytes that are not text. Of `-c fog
    -c snow`, Typer would silently use only `snow`, and the path in `--data "$UNSET"` would be the working folder.
    """

    def __init__(self, name: str, *, help: str | None = None, **settings: Any) -> None:
        paragraphs = inspect.cleandoc(help or "").split("\n\n")
        wrapped = [text if text.startswith("\b") else text.replace("\n", " ") for text in paragraphs]
        super().__init__(name, help="\n\n".join(wrapped), **settings)
        for option in self.params:
            if name != "run" and isinstance(option, TyperOption):
                option.rich_help_panel = None

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        if ctx.resilient_parsing:  # a shell asks for completions
            return super().parse_args(ctx, args)
        for text in args:
            if not is_utf8(text):
                raise UsageError(text, "not valid UTF-8: rename the file or folder")
        try:
            values, extra, given = self.make_parser(ctx).parse_args(list(args))
        except Exception as error:
            if type(error).__name__ != "NoSuchOption":
                raise
            commands = typer.main.get_command(command_line()).commands  # type: ignore[attr-defined]
            raise unknown_option(self, error.option_name, commands) or error from None  # type: ignore[attr-defined]
        if extra and (better := advice(self, extra[0], given=values)):
            raise better
        for parameter in self.params:
            value = values.get(parameter.name)
            texts = value if isinstance(value, list | tuple) else (value,)
            if any(isinstance(text, str) and not text.strip(" ,") for text in texts):
                raise UsageError(parameter.opts[0], "empty: give a value, or omit it")
        for option, times in Counter(given).items():
            not_repeatable = isinstance(option, TyperOption) and not (option.multiple or option.is_flag)
            if not_repeatable and times > 1:
                raise UsageError(
                    option.opts[0], f"given {times} times; give it once, with commas between several values"
                )
        with nullcontext() if values.get("help") else results_only():  # an option may import a user's module
            rest = super().parse_args(ctx, args)
        ctx.params.update({name: _expanded(value) for name, value in ctx.params.items()})
        return rest

    def invoke(self, ctx: Any) -> Any:
        given = dict(ctx.params)
        try:
            with results_only():
                return super().invoke(ctx)
        except RobustFlowError as error:
            raise explained(self, error, given) from error.__cause__


class _Commands(TyperGroup):
    """The commands; a word that is not one of them is explained if it names something else."""

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        if self.get_command(ctx, args[0]) is None and (better := advice(self, args[0])):
            raise better
        return super().resolve_command(ctx, args)


def _expanded(value: Any) -> Any:
    """Expand `~` in paths: of `--output=~/run`, a shell leaves it as it is."""
    if isinstance(value, list):
        return [_expanded(item) for item in value]
    return user_path(value) if isinstance(value, Path) else value


def _listed(name: str) -> Callable[[], None]:
    """Return a stand-in for a command's function with its help, which is read without an import."""

    def command() -> None:
        raise AssertionError("a command registered only for listing was called")

    source = Path(__file__).with_name(f"{_module(name)}.py").read_text(encoding="utf-8")
    functions = (node for node in ast.parse(source).body if isinstance(node, ast.FunctionDef))
    command.__doc__ = next(ast.get_docstring(node) for node in functions if node.name == _module(name))
    return command


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"robustflow {__version__}")
        raise typer.Exit


def _options(
    context: typer.Context,
    version: bool = typer.Option(False, "--version", callback=_version, is_eager=True, help="Print the version."),
    debug: bool = typer.Option(False, "--debug", help="Print the full traceback of an error."),
) -> None:
    context.with_resource(options_named())


def __getattr__(name: str) -> typer.Typer:
    if name != "app":
        raise AttributeError(name)
    return command_line()


def main() -> None:
    """Run the command line. A known error is printed as one line on stderr and sets the exit code; a warning is one
    line."""
    warnings.formatwarning = plain_warning
    _replace_closed_streams()
    ignore_local_settings()
    os.environ[SAFE_PATH] = "1"  # inherited by every child process
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")  # a terminal with a small character set shows question marks
    debug = "--debug" in sys.argv[1:]
    arguments = [argument for argument in sys.argv[1:] if argument != "--debug"]
    # shells request completions for any command through the environment
    completing = "_ROBUSTFLOW_COMPLETE" in os.environ
    try:
        if any(not argument.startswith("-") for argument in arguments):
            _require_memory()
        command_line(None if completing else arguments)(arguments)
    except (RobustFlowError, OSError) as error:
        if debug:
            traceback.print_exception(error)
        expected = isinstance(error, RobustFlowError)
        line = str(error) if expected else f"{error}; check the file or device, or use --debug for the full traceback"
        print(f"robustflow: {plain(line, None)}", file=sys.stderr)
        sys.exit(error.exit_code if isinstance(error, RobustFlowError) else 1)
    except KeyboardInterrupt:  # raised outside a command
        sys.exit(130)
    except Exception as error:
        if debug or not (isinstance(error, MemoryError) or _memory_limit() < math.inf):
            raise
        more = f", of {_memory_limit() / 1e9:.1f} GB allowed by ulimit" if _memory_limit() < math.inf else ""
        line = f"probably out of memory{more} ({class_and_message(error)}); use --debug for the full traceback"
        print(f"robustflow: {plain(line, 500)}", file=sys.stderr)
        sys.exit(1)


def _replace_closed_streams() -> None:
    """Open the null device in place of closed streams: a file opened later must not get their numbers."""
    closed = [number for number, stream in enumerate((sys.stdin, sys.stdout, sys.stderr)) if stream is None]
    for number in closed:
        os.dup2(os.open(os.devnull, os.O_RDWR), number)
    for number, name in ((1, "stdout"), (2, "stderr")):
        if number in closed:
            setattr(sys, name, open(number, "w", closefd=False))  # noqa: SIM115
    if 1 in closed:
        warnings.warn("the standard output is closed, so nothing is printed there", stacklevel=2)


def _memory_limit() -> float:
    """Return the limit of the address space that `ulimit -v` sets, in bytes."""
    try:
        import resource
    except ImportError:  # Windows
        return math.inf
    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    return math.inf if limit == resource.RLIM_INFINITY else limit


def _require_memory() -> None:
    """Raise if the imported libraries would run out of address space, which ends some of them without an exception."""
    if (limit := _memory_limit()) < _LEAST_MEMORY:
        need = "allow at least 4 GB, as with ulimit -v 4000000"
        raise RobustFlowError("ulimit -v", f"only {limit / 1e9:.2f} GB of address space; {need}")
