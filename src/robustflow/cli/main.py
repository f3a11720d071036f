"""The command `robustflow`: its subcommands, and how errors are printed."""

import sys
import traceback
import warnings

import typer

from .. import __version__
from ..errors import RobustFlowError, plain_warning
from .app import app as local_app
from .audit import audit
from .calibrate import calibrate
from .compare import compare
from .corrupt import corrupt
from .displacement import displacement
from .examples import examples
from .experiment import app as experiment
from .export import export
from .gallery import gallery
from .leaderboard import leaderboard
from .listing import list_things
from .optics import app as optics
from .pack import pack
from .predict import predict
from .prepare import prepare
from .profile import profile
from .report import report
from .reproduce import reproduce
from .run import run
from .show import show
from .train import train
from .verify import verify

app = typer.Typer(
    name="robustflow",
    help="How robust is an optical-flow model to image corruptions?",
    epilog="Start with: robustflow run --model dis",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
app.command("run")(run)
app.command("predict")(predict)
app.command("show")(show)
app.command("examples")(examples)
app.command("train")(train)
app.command("profile")(profile)
app.command("report")(report)
app.command("reproduce")(reproduce)
app.command("compare")(compare)
app.command("leaderboard")(leaderboard)
app.command("audit")(audit)
app.command("pack")(pack)
app.command("verify")(verify)
app.command("list")(list_things)
app.command("corrupt")(corrupt)
app.command("export")(export)
app.command("gallery")(gallery)
app.command("app")(local_app)
app.command("displacement")(displacement)
app.command("calibrate")(calibrate)
app.add_typer(prepare, name="prepare")
app.add_typer(optics, name="optics")
app.add_typer(experiment, name="experiment")


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"robustflow {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: bool = typer.Option(False, "--version", callback=_version, is_eager=True, help="Print the version."),
    debug: bool = typer.Option(False, "--debug", help="Print the full traceback of an error."),
) -> None:
    pass


def main() -> None:
    """Run the command line; a known error becomes one line on stderr and its exit code, a warning becomes one line."""
    warnings.formatwarning = plain_warning
    debug = "--debug" in sys.argv[1:]
    try:
        app([argument for argument in sys.argv[1:] if argument != "--debug"])
    except RobustFlowError as error:
        if debug:
            traceback.print_exception(error)
        from ..text import plain

        print(f"robustflow: {plain(str(error), None)}", file=sys.stderr)
        sys.exit(error.exit_code)
