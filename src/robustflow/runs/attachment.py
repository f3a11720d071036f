"""A small JSON file stored with a run's rows: it belongs to exactly that run, and may come from anyone."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, TypeVar

from pydantic import Field, ValidationError

from ..errors import RunError, first_misfit
from ..links import not_a_link
from ..sealed import unsealed
from ..validated import Untrusted

if TYPE_CHECKING:
    from .run import Run


class RunAttachment(Untrusted):
    """The fields that every such file has.

    Attributes:
        version: of this file.
        run: the digest of the run's identity.
    """

    version: Annotated[int, Field(ge=1, le=1)] = 1
    run: Annotated[str, Field(pattern="^[0-9a-f]{16}$")]


Attachment = TypeVar("Attachment", bound=RunAttachment)


def parse_attachment(kind: type[Attachment], data: bytes, name: str, command: str) -> Attachment:
    """The contents of such a file.

    Args:
        kind: the class of its contents.
        data: the file.
        name: of the file, for messages.
        command: the `robustflow` command that writes it again.

    Raises:
        RunError: damaged, or not in this shape; the first mismatch is named.
    """
    content = unsealed(data)
    if content is None:
        raise RunError(
            f"{name} is damaged (its content does not match its digest); delete it, or write it again with robustflow "
            f"{command}"
        )
    try:
        return kind.model_validate_json(content)
    except ValidationError as error:
        raise RunError(
            f"{name}: {first_misfit(error)}; delete it, or write it again with robustflow {command}"
        ) from error


def read_attachment(kind: type[Attachment], run: Run, file: str, largest: int, command: str) -> Attachment | None:
    """The contents of such a file of a run; None if there is none.

    Args:
        kind: the class of its contents.
        run: in whose folder it is.
        file: its name.
        largest: largest number of bytes that are read.
        command: the `robustflow` command that writes it again.

    Raises:
        RunError: it is damaged, or belongs to another run.
    """
    path = run.path / file
    if not path.is_file():
        return None  # reading a pipe could block
    try:
        with open(path, "rb", opener=not_a_link) as opened:
            data = opened.read(largest)
    except OSError:
        return None
    contents = parse_attachment(kind, data, str(path), command)
    if contents.run != run.manifest.identity_digest:
        raise RunError(f"{path} belongs to another run ({contents.run}); delete it, or create it again")
    return contents
