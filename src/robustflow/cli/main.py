"""The `robustflow` command: subcommands and error output."""

import inspect
import io
import os
import sys
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

import typer
from typer.core import TyperCommand, TyperOption

from .. import __version__
from ..core.display import ignore_local_settings
from ..core.errors import RobustFlowError, UsageError, plain_warning
from ..core.paths import user_path
from ..core.processes import SAFE_PATH
from ..core.text import is_utf8, plain

_PANELS = {
    "Measure": {
        "run": "Measure the robustness of a model, or of several models one after another.",
        "predict": "Predict the flow of each pair of adjacent frames, and write it in a standard file format.",
        "profile": "Count the parameters and multiply-accumulates (MACs) of models, and time their predictions.",
    },
    "Look": {
        "report": "Print runs and update their pages; or make tables, figures or example pictures of them.",
        "gallery": "Show the corruptions: gallery.png and gallery.pdf at one severity, gallery.html with a slider over "
        "all five.",
    },
    "Compare and share": {
        "compare": "Test whether models differ, paired by image, with intervals and corrected p-values.",
        "leaderboard": "Build a leaderboard: a self-contained index.html, and results.csv.",
        "record": "Pack a run into one file, and verify such files.",
    },
    "Train": {"train": "Train a network with a recipe of the paper or of the network's authors."},
    "The paper": {"reproduce": "Reproduce the paper: a table or figure (reproduce tab2), its audit, its experiments."},
    "Make": {
        "corrupt": "Corrupt two frames and write them as <corruption>_<severity>/<frame's name>.png.",
        "export": "Write a benchmark's frames to clean|<corruption>_<severity>/val/{image_2,flow_occ}, or a run's rows "
        "or results.",
        "prepare": "Prepare a benchmark's data from recordings, or list the digests of a dataset.",
        "optics": "Design, show and render the lenses of psf_blur; calibrate severities.",
    },
    "More": {
        "app": "Choose a pair, a model and corruptions in the browser, and see how the frames, the flow and its errors "
        "change.",
        "list": "List models, corruptions, attacks, benchmarks, datasets or training recipes.",
        "check": "Test your own model, corruption, attack or dataset: shapes, dtypes, determinism, unmodified inputs.",
    },
}
"""Commands by heading in `--help`, each in the module of its name, with the first paragraph of its help. Under each
heading, groups come after single commands, as in Typer's output."""

_GROUPS = ("record", "reproduce", "prepare", "optics")


def command_line(arguments: Sequence[str] | None = None) -> typer.Typer:
    """Build the command line; with `arguments`, only the commands that they name are imported and have options, so
    that `--help` is fast."""
    app = typer.Typer(
        name="robustflow",
        help="How robust is an optical-flow model to image corruptions?",
        epilog="Start with: robustflow run --model dis",
        no_args_is_help=True,
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": ["-h", "--help"]},
    )
    app.callback()(_options)
    for panel, commands in _PANELS.items():
        for name, description in commands.items():
            wanted = arguments is None or name in arguments
            if name in _GROUPS:
                group = _command(name) if wanted else typer.Typer(help=description)
                for one in group.registered_commands:
                    one.cls = _Command
                app.add_typer(group, name=name, rich_help_panel=panel)
            else:
                function = _command(name) if wanted else _listed(description)
                app.command(name, cls=_Command, rich_help_panel=panel)(function)
    return app


def _command(name: str) -> Any:
    """Return the function or group of a command, named as its module."""
    name = "listing" if name == "list" else name
    return getattr(import_module(f".{name}", __package__), "app" if name in _GROUPS else name)


class _Command(TyperCommand):
    """A command that refuses an option given twice, an empty value or list, and bytes that are not text. Of `-c fog
    -c snow`, Typer would silently use only `snow`, and the path in `--data "$UNSET"` would be the working folder.
    """

    def __init__(self, name: str, *, help: str | None = None, **settings: Any) -> None:
        paragraphs = inspect.cleandoc(help or "").split("\n\n")
        wrapped = [one if one.startswith("\b") else one.replace("\n", " ") for one in paragraphs]
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
        values, _, given = self.make_parser(ctx).parse_args(list(args))
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
        rest = super().parse_args(ctx, args)
        ctx.params.update({name: _expanded(value) for name, value in ctx.params.items()})
        return rest


def _expanded(value: Any) -> Any:
    """Expand `~` in paths: of `--output=~/run`, a shell leaves it as it is."""
    if isinstance(value, list):
        return [_expanded(each) for each in value]
    return user_path(value) if isinstance(value, Path) else value


def _listed(description: str) -> Callable[[], None]:
    def command() -> None:
        raise AssertionError("a command registered only for listing was called")

    command.__doc__ = description
    return command


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"robustflow {__version__}")
        raise typer.Exit


def _options(
    version: bool = typer.Option(False, "--version", callback=_version, is_eager=True, help="Print the version."),
    debug: bool = typer.Option(False, "--debug", help="Print the full traceback of an error."),
) -> None:
    pass


def __getattr__(name: str) -> typer.Typer:
    if name != "app":
        raise AttributeError(name)
    return command_line()


def main() -> None:
    """Run the command line. A known error is printed as one line on stderr and sets the exit code; a warning is one
    line."""
    warnings.formatwarning = plain_warning
    ignore_local_settings()
    os.environ[SAFE_PATH] = "1"  # inherited by every child process
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")  # a terminal with a small character set shows question marks
    debug = "--debug" in sys.argv[1:]
    arguments = [argument for argument in sys.argv[1:] if argument != "--debug"]
    # shells request completions for any command through the environment
    completing = "_ROBUSTFLOW_COMPLETE" in os.environ
    try:
        command_line(None if completing else arguments)(arguments)
    except (RobustFlowError, OSError) as error:
        if debug:
            traceback.print_exception(error)
        known = isinstance(error, RobustFlowError)
        line = str(error) if known else f"{error}; check the file or device, or use --debug for the full traceback"
        print(f"robustflow: {plain(line, None)}", file=sys.stderr)
        sys.exit(error.exit_code if isinstance(error, RobustFlowError) else 1)
    except KeyboardInterrupt:  # raised outside a command
        sys.exit(130)
