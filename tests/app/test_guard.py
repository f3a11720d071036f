"""Test which requests the app accepts, depending on host, origin and token, and which headers every response has."""

from __future__ import annotations

import asyncio
import json
import signal
import socket
import time
from contextlib import ExitStack, closing
from http.client import HTTPConnection
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from starlette.responses import PlainTextResponse

from robustflow.app.serve import Guard, serve
from robustflow.core.errors import ModelError, UsageError
from robustflow.models import ModelRef
from tests.data.video import clips
from tests.refusals import refusal

from .launch import SCRIPTED, running_app


def test_the_page_needs_no_token_and_contains_none(app):
    for path in ("/", f"/?token={app.token}"):
        status, page, headers = app.ask("GET", path, x_token="")
        assert status == 200
        assert b"<title>RobustFlow" in page
        assert app.token.encode() not in page
        assert "set-cookie" not in headers, "a cookie would be sent to servers on other ports"


@pytest.mark.parametrize(
    ("method", "path"), [("GET", "/choices"), ("GET", "/no-such"), ("POST", "/preview"), ("POST", "/upload")]
)
@pytest.mark.parametrize("token", ["", "guessed", "{token}x", "\xff"])
def test_nothing_but_the_page_is_served_without_the_token(app, method, path, token):
    query, cookie = f"?token={app.token}", f"token={app.token}"
    status, body, _ = app.ask(method, path + query, x_token=token.format(token=app.token), cookie=cookie)
    assert (status, list(json.loads(body))) == (403, ["error"])


def test_the_token_is_not_an_argument_of_the_browser(tmp_path, monkeypatch):
    """All users can read the arguments of a process, but only this user the file that is passed instead."""
    opened = tmp_path / "opened"
    browser = tmp_path / "browser"
    browser.write_text(f'#!/bin/sh\necho "$@" > {opened}.part; mv {opened}.part {opened}\n')
    browser.chmod(0o700)
    monkeypatch.setenv("BROWSER", str(browser))
    with running_app(tmp_path, "--browser") as running:
        while not opened.exists():
            time.sleep(0.02)
        assert running.token not in opened.read_text()
        page = Path(urlsplit(opened.read_text().strip()).path)
        assert running.address in page.read_text()
        assert (page.stat().st_mode & 0o777, page.parent.stat().st_mode & 0o777) == (0o600, 0o700)
    assert not page.exists()


@pytest.mark.parametrize(
    "host",
    [
        "evil.example",
        "evil.example:{port}",
        "127.0.0.1",
        "127.0.0.1:1",
        "192.168.0.7:{port}",
        "localhost.evil.example:{port}",
    ],
)
def test_request_for_a_different_host_is_refused(app, host):
    port = app.host.rpartition(":")[2]
    name = host.format(port=port)
    for path in ("/", f"/?token={app.token}", "/choices"):
        assert app.ask("GET", path, host=name, origin=f"http://{name}")[0] == 421


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost", "[::1]", "127.0.0.1:80"])
def test_guard_on_port_80_answers_hosts_that_omit_it(host):
    """Browsers omit the default port in the headers Host and Origin."""
    sent = []

    async def send(message):
        sent.append(message)

    headers = [(b"host", host.encode()), (b"origin", f"http://{host}".encode())]
    scope = {"type": "http", "method": "GET", "path": "/", "query_string": b"", "headers": headers}
    asyncio.run(Guard(PlainTextResponse("page"), "secret", 80, ["/"])(scope, None, send))
    assert sent[0]["status"] == 200


@pytest.mark.parametrize("origin", ["", "null", "http://evil.example", "https://{host}", "http://{host}.evil.example"])
@pytest.mark.parametrize("path", ["/preview", "/upload"])
def test_post_from_a_different_origin_is_refused(app, path, origin):
    status, body, _ = app.ask("POST", path, "{}", origin=origin.format(host=app.host))
    assert (status, list(json.loads(body))) == (403, ["error"])


@pytest.mark.parametrize("path", ["/", "/app.js", "/results.js", "/app.css", "/choices", "/missing"])
def test_every_answer_has_security_headers(app, path):
    _, body, headers = app.ask("GET", path)
    policy = headers["content-security-policy"]
    assert "default-src 'none'" in policy
    assert "unsafe" not in policy
    assert "http" not in policy
    assert headers["x-content-type-options"] == "nosniff"
    assert headers["cache-control"] == "no-store"
    assert headers["x-frame-options"] == "DENY"
    assert "access-control-allow-origin" not in headers
    assert "server" not in headers
    if path in ("/", "/app.css"):
        assert b"http" not in body.replace(b"http-equiv", b""), "no address of another server"


def test_unsupported_http_methods_are_refused(app):
    for method in ("PUT", "DELETE", "PATCH", "OPTIONS"):
        assert app.ask(method, "/preview")[0] == 405
    assert app.ask("GET", "/preview")[0] == 405


@pytest.mark.parametrize(("stop", "predicting"), [(signal.SIGINT, True), (signal.SIGTERM, False)])
def test_interrupted_app_ends_without_a_message(tmp_path, monkeypatch, stop, predicting):
    scratch = tmp_path / "scratch"
    monkeypatch.setenv("TMPDIR", str(scratch))
    scratch.mkdir()
    with running_app(tmp_path, "--model", SCRIPTED) as running, ExitStack() as stack:
        clip = clips.clip(tmp_path / "clip.mp4", 3).path.read_bytes()
        assert running.upload(clip=("clip.mp4", clip))[0] == 200
        assert any(scratch.rglob("clip.mp4")), "a clip is decoded on demand"
        for path in ("/preview", "/upload"):  # a page that is closed while it sends
            half = {"X-Token": running.token, "Origin": f"http://{running.host}", "Content-Length": "100"}
            with closing(HTTPConnection(running.host)) as page:
                page.request("POST", path, b"-", half | {"Content-Type": "multipart/form-data; boundary=x"})
        malformed = running.ask("POST", "/upload", b"x", content_type="multipart/form-data; boundary=b")
        assert malformed[0] == 400
        if predicting:
            stack.enter_context(running.model_does("wait"))
            stack.enter_context(running.waiting_preview()).getresponse().readline()
        running.process.send_signal(stop)
        out, error = running.process.communicate(timeout=30)
        assert (running.process.returncode, out, error) == (0, "", "")
        assert not list(scratch.iterdir())


@pytest.mark.parametrize(
    ("ref", "error", "culprit"),
    [
        (ModelRef.parse("models_of_nobody:Net"), UsageError, "models_of_nobody:Net"),
        (ModelRef.parse("raft", {"checkpoint": "/nowhere.pth"}), ModelError, "/nowhere.pth"),
    ],
)
def test_a_given_model_that_cannot_be_loaded_ends_the_app(ref, error, culprit):
    refusal(lambda: serve([ref], port=0, browser=False), error, culprit)


def test_port_in_use_is_refused():
    with socket.socket() as server:
        server.bind(("127.0.0.1", 0))
        server.listen()
        refusal(lambda: serve([], port=server.getsockname()[1], browser=False), UsageError, "--host")


def test_app_listens_to_other_machines_only_on_request_and_warns(tmp_path):
    with running_app(tmp_path, "--host", "0.0.0.0") as running:
        port = running.host.rpartition(":")[2]
        assert running.ask("GET", "/choices", host=f"192.168.0.7:{port}")[0] == 200
        assert running.ask("GET", "/choices", host=f"evil.example:{port}")[0] == 421
        running.process.send_signal(signal.SIGINT)
        assert running.process.communicate(timeout=30)[1].startswith("robustflow: warning: ")
