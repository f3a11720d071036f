"""Who is let in: hosts, origins, tokens, and what every answer says about itself."""

from __future__ import annotations

import http.client
import json
import signal
import socket
import subprocess
import sys
import time

import pytest

from ..video import clips
from .launch import running_app


def test_the_address_gives_a_cookie_and_loses_its_token(app):
    status, _, headers = app.ask("GET", f"/?token={app.token}", cookie="")
    assert (status, headers["location"]) == (303, "/")
    cookie = headers["set-cookie"]
    assert cookie.startswith(f"{app.cookie};")
    assert "HttpOnly" in cookie
    assert "samesite=strict" in cookie.lower()
    status, page, _ = app.ask("GET", "/")
    assert status == 200
    assert b"<title>RobustFlow" in page
    assert app.token.encode() not in page


@pytest.mark.parametrize("path", ["/", "/app.js", "/app.css", "/choices", "/?token=", "/?token=guessed", "/no-such"])
@pytest.mark.parametrize("cookie", ["", "robustflow-1=x", "{cookie}x", "=", "robustflow=\xff"])
def test_nothing_without_the_token(app, path, cookie):
    status, body, _ = app.ask("GET", path, cookie=cookie.format(cookie=app.cookie))
    assert (status, body.count(b"\n")) == (403, 1)


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
def test_another_host_is_not_answered(app, host):
    port = app.host.rpartition(":")[2]
    name = host.format(port=port)
    for path in ("/", f"/?token={app.token}", "/choices"):
        status, _, headers = app.ask("GET", path, host=name, origin=f"http://{name}")
        assert status == 421
        assert "set-cookie" not in headers


@pytest.mark.parametrize("origin", ["", "null", "http://evil.example", "https://{host}", "http://{host}.evil.example"])
@pytest.mark.parametrize("path", ["/preview", "/upload"])
def test_a_post_from_elsewhere_is_refused(app, path, origin):
    status, body, _ = app.ask("POST", path, "{}", origin=origin.format(host=app.host))
    assert (status, body) == (403, b"requests from other pages are refused\n")


@pytest.mark.parametrize("path", ["/", "/app.js", "/results.js", "/app.css", "/choices", "/missing"])
def test_every_answer_is_locked_down(app, path):
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


def test_methods_that_have_no_meaning(app):
    for method in ("PUT", "DELETE", "PATCH", "OPTIONS"):
        assert app.ask(method, "/preview")[0] == 405
    assert app.ask("GET", "/preview")[0] == 405


@pytest.mark.parametrize("stop", [signal.SIGINT, signal.SIGTERM])
def test_interrupt_ends_it_without_a_word(tmp_path, monkeypatch, stop):
    monkeypatch.setenv("TMPDIR", str(tmp_path / "scratch"))
    (tmp_path / "scratch").mkdir()
    with running_app(tmp_path) as running:
        clip = clips.clip(tmp_path / "clip.mp4", 3).path.read_bytes()
        assert running.upload(clip=("clip.mp4", clip))[0] == 200
        assert list((tmp_path / "scratch").iterdir()), "a clip is decoded as it is asked for"
        running.process.send_signal(stop)
        out, error = running.process.communicate(timeout=30)
        assert (running.process.returncode, out, error) == (0, "", "")
        assert not list((tmp_path / "scratch").iterdir())


def test_a_killed_app_leaves_nothing_for_good(tmp_path, monkeypatch):
    scratch = tmp_path / "scratch"
    monkeypatch.setenv("TMPDIR", str(scratch))
    scratch.mkdir()
    with running_app(tmp_path) as killed:
        clip = clips.clip(tmp_path / "clip.mp4", 3).path.read_bytes()
        assert killed.upload(clip=("clip.mp4", clip))[0] == 200
        killed.process.kill()
        killed.process.wait(timeout=30)
    left = {path.name for path in scratch.iterdir()}
    assert left
    with running_app(tmp_path) as running:
        assert not left & {path.name for path in scratch.iterdir()}
        assert running.upload(clip=("clip.mp4", clip))[0] == 200
        with running_app(tmp_path) as beside:  # does not take the folder of one that is running
            assert beside.ask("GET", "/choices")[0] == 200
            assert running.preview(source="demo")[0] == 200
            assert any(path.is_dir() and any(path.rglob("clip.mp4")) for path in scratch.iterdir())


def test_half_sent_requests_do_not_shut_others_out(app):
    """More of them than connections are allowed: they are closed, and the page is answered again."""
    host, port = app.host.split(":")
    sockets = [socket.create_connection((host, int(port)), timeout=60) for _ in range(70)]
    try:
        for one in sockets:
            one.sendall(b"GET / HTTP/1.1\r\nHost: ")
        sockets[0].sendall(b"x")  # a byte now and then does not buy more time
        closed = [one.recv(4096) for one in sockets]
        assert all(data == b"" or b" 503 " in data for data in closed)
        assert app.ask("GET", "/choices")[0] == 200
    finally:
        for one in sockets:
            one.close()


def test_interrupt_in_the_middle_of_a_prediction(tmp_path):
    with running_app(tmp_path, "--model", "models_for_app:Slow") as running:
        connection = http.client.HTTPConnection(running.host, timeout=30)
        request = {"page": "p", "source": "demo", "index": 0, "model": "models_for_app:Slow", "seed": 0}
        request |= {"layers": [{"name": "fog", "severity": 1}]}
        headers = {"Cookie": running.cookie, "Origin": f"http://{running.host}"}
        connection.request("POST", "/preview", json.dumps(request), headers)
        connection.getresponse().readline()
        running.process.send_signal(signal.SIGINT)
        _, error = running.process.communicate(timeout=30)
        connection.close()
        assert (running.process.returncode, error) == (0, "")


def test_interrupt_ends_it_while_a_model_that_holds_the_lock_is_loaded(tmp_path):
    """No Python runs then, no signal handler either. The issue's limit is 15 s."""
    with running_app(tmp_path, "--model", "models_for_app:HoldsTheLock") as running:
        connection = http.client.HTTPConnection(running.host, timeout=30)
        request = {"page": "p", "source": "demo", "index": 0, "model": "models_for_app:HoldsTheLock", "seed": 0}
        request |= {"layers": [{"name": "fog", "severity": 1}]}
        headers = {"Cookie": running.cookie, "Origin": f"http://{running.host}"}
        connection.request("POST", "/preview", json.dumps(request), headers)
        time.sleep(1)
        running.process.send_signal(signal.SIGINT)
        running.process.communicate(timeout=15)
        connection.close()


def _once(*arguments: str) -> subprocess.CompletedProcess[str]:
    main = "from robustflow.cli.main import main; main()"
    return subprocess.run(
        [sys.executable, "-c", main, "app", "--no-browser", *arguments], capture_output=True, text=True, timeout=60
    )


def test_a_port_that_is_taken():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        found = _once("--port", str(taken.getsockname()[1]))
    assert found.returncode == 2
    assert "cannot listen on 127.0.0.1 port" in found.stderr
    assert found.stderr.count("\n") == 1


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("--port", "70000"), "port 70000 does not exist"),
        (("--host", "203.0.113.1"), "cannot listen on 203.0.113.1"),
        (("-O", "preset=fast"), "preset is an option of a model"),
    ],
)
def test_what_cannot_be_served(arguments, says):
    found = _once(*arguments)
    assert found.returncode == 2
    assert says in found.stderr
    assert found.stderr.count("\n") == 1


def test_other_machines_only_when_requested_and_with_a_warning(tmp_path):
    with running_app(tmp_path, "--host", "0.0.0.0") as running:
        port = running.host.rpartition(":")[2]
        assert running.ask("GET", "/choices", host=f"192.168.0.7:{port}")[0] == 200
        assert running.ask("GET", "/choices", host=f"evil.example:{port}")[0] == 421
        running.process.send_signal(signal.SIGINT)
        assert "warning: anyone who can reach this machine" in running.process.communicate(timeout=30)[1]
