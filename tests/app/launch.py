"""The app in a separate process, and a client that talks to it over a real socket."""

from __future__ import annotations

import http.client
import json
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from uuid import uuid4

_MAIN = "from robustflow.cli.main import main; main()"


def with_demo(place: str) -> tuple[str, str]:
    """Arguments that make Python start the app with the demo pair of the fixture `small_demo`."""
    return "-c", f"import skimage; skimage.__file__ = {place!r}; {_MAIN}"


SCRIPTED = "models_for_app:Scripted"
_MODELS = """
import time
from pathlib import Path

import numpy as np

class Scripted:
    def predict(self, frame1, frame2):
        while Path("wait").exists():
            time.sleep(0.02)
        if Path("fail").exists():
            raise ValueError("<b>no</b> weights\\nat all")
        if Path("exit").exists():
            raise SystemExit(3)
        return np.zeros((*frame1.shape[:2], 2), np.float32)
"""


@dataclass
class App:
    """A running app.

    Attributes:
        process: the app's process.
        folder: its working folder.
        host: "127.0.0.1:PORT".
        address: URL printed by the app, with the token.
    """

    process: subprocess.Popen[str]
    folder: Path
    host: str
    address: str

    @property
    def token(self) -> str:
        return self.address.partition("token=")[2]

    def ask(self, method: str, path: str, body: bytes | str | None = None, **headers: str) -> tuple[int, bytes, Any]:
        """Return status, body and headers. A header passed as, for example, `content_type=` replaces the usual one; ""
        omits it."""
        own = {"X-Token": self.token, "Host": self.host, "Origin": f"http://{self.host}"}
        own |= {name.replace("_", "-").title(): value for name, value in headers.items()}
        connection = http.client.HTTPConnection(self.host, timeout=60)
        try:
            connection.putrequest(method, path, skip_host=True)
            data = body.encode() if isinstance(body, str) else body
            for name, value in own.items():
                if value:
                    connection.putheader(name, value)
            if data is not None and "Content-Length" not in own:
                connection.putheader("Content-Length", str(len(data)))
            connection.endheaders(data)
            response = connection.getresponse()
            return response.status, response.read(), response.headers
        finally:
            connection.close()

    def preview(self, **changed: Any) -> tuple[int, list[dict[str, Any]]]:
        """Request a preview of the demo pair under fog 3; return status and messages."""
        status, body, _ = self.ask("POST", "/preview", _request(**changed))
        return status, [json.loads(line) for line in body.splitlines()]

    @contextmanager
    def model_does(self, what: str) -> Iterator[None]:
        """Make the model `SCRIPTED` "wait" until the end of the block, "fail", or "exit"."""
        (self.folder / what).touch()
        try:
            yield
        finally:
            (self.folder / what).unlink()

    @contextmanager
    def waiting_preview(self, **changed: Any) -> Iterator[http.client.HTTPConnection]:
        """Send a preview request without waiting for the response."""
        connection = http.client.HTTPConnection(self.host, timeout=60)
        headers = {"X-Token": self.token, "Origin": f"http://{self.host}"}
        connection.request("POST", "/preview", _request(**{"model": SCRIPTED} | changed), headers)
        try:
            yield connection
        finally:
            connection.close()

    def upload(self, **files: tuple[str, bytes]) -> tuple[int, dict[str, Any]]:
        """Upload files, given as field=(file name, contents); return status and response."""
        edge = uuid4().hex
        parts = [
            f'--{edge}\r\nContent-Disposition: form-data; name="{field}"; filename="{name}"\r\n\r\n'.encode()
            + data
            + b"\r\n"
            for field, (name, data) in files.items()
        ]
        body = b"".join(parts) + f"--{edge}--\r\n".encode()
        status, answer, _ = self.ask("POST", "/upload", body, content_type=f"multipart/form-data; boundary={edge}")
        return status, json.loads(answer)


def _request(**changed: Any) -> str:
    request = {"page": uuid4().hex, "source": "demo", "index": 0, "model": "dis", "seed": 0}
    return json.dumps(request | {"layers": [{"name": "fog", "severity": 3}]} | changed)


@contextmanager
def running_app(folder: Path, *arguments: str, start: tuple[str, ...] = ("-c", _MAIN)) -> Iterator[App]:
    """Start the app in `folder`, where `models_for_app` is importable; it is interrupted at the end.

    Args:
        folder: the working folder.
        arguments: command-line arguments.
        start: arguments that make Python start the app.
    """
    (folder / "models_for_app.py").write_text(_MODELS)
    process = subprocess.Popen(
        [sys.executable, *start, "app", "--no-browser", "--port", "0", *arguments],
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        assert process.stdout is not None
        line = process.stdout.readline()
        found = re.search(r"(http://([^/]+)/\?token=\S+)", line)
        assert found, f"{line!r} {process.communicate(timeout=30)}"
        yield App(process, folder, found[2], found[1])
    finally:
        running = process.poll() is None
        if running:
            process.send_signal(signal.SIGINT)
        try:
            process.communicate(timeout=30)
            assert not running or process.returncode == 0
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()
            raise
