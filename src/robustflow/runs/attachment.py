"""Read and write small JSON files stored with a run's rows. Each file belongs to exactly one run and is untrusted."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar

from pydantic import Field, ValidationError

from ..atomic import write_json
from ..errors import RunError, first_misfit
from ..sealed import sealed, unsealed
from ..validated import Untrusted

if TYPE_CHECKING:
    from .run import Run


class RunAttachment(Untrusted):
    """The fields that every such file contains."""

    version: Annotated[int, Field(ge=1, le=1)] = 1
    run: Annotated[str, Field(pattern="^[0-9a-f]{16}$")]


Attachment = TypeVar("Attachment", bound=RunAttachment)


def parse_attachment(kind: type[Attachment], data: bytes, name: str, command: str) -> Attachment:
    """Parse the contents of such a file."""
    content = unsealed(data)
    if content is None:
        raise RunError(
            f"{name} is damaged (its content does not match its digest); delete it, or recreate it with robustflow "
            f"{command}"
        )
    try:
        return kind.model_validate_json(content)
    except ValidationError as error:
        raise RunError(f"{name}: {first_misfit(error)}; delete it, or recreate it with robustflow {command}") from error


def read_attachment(kind: type[Attachment], run: Run, file: str, largest: int, command: str) -> Attachment | None:
    """Read such a file from a run's folder; None if it does not exist."""
    path = run.path / file
    if not path.is_file():
        return None  # only regular files, because reading a pipe could block
    try:
        with open(path, "rb") as opened:
            data = opened.read(largest)
    except OSError:
        return None
    contents = parse_attachment(kind, data, str(path), command)
    if contents.run != run.manifest.identity_digest:
        raise RunError(f"{path} belongs to a different run ({contents.run}); delete or recreate it")
    return contents


def write_attachment(run: Run, file: str, content: RunAttachment) -> Path:
    """Store such a file in a run's folder, and return its path."""
    path: Path = run.path / file
    write_json(path, sealed(content.model_dump()))
    return path
