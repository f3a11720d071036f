"""Connect to an existing Ray cluster, or start one on this machine that ends with the run.

What is set in `ray._private` and in `_py_driver_sys_path` has no public counterpart in Ray 2.54 to 2.60.
"""

from __future__ import annotations

import logging
import os
import signal
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from typing import Any

from ...core.environment import environment_variables, safe_path
from ...core.errors import RobustFlowError, RunError, UsageError
from ...core.files import scratch_folder
from ...core.plugins import require
from . import ray_watch

REACH_S = 10.0
"""Time limit for the head of a cluster to respond, in seconds."""
_STORE_BYTES = 200 * 2**20
"""Size of the object store of a local cluster in bytes, excluding the data sent to every actor; rows are small."""
_LONGEST_TMP = 30
"""Maximum length of the path of Ray's folder, because the paths of its sockets may have at most 107 characters."""
_SETTINGS = b"\4"
_PREFACE = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n\0\0\0" + _SETTINGS + bytes(5)
"""The client preface of HTTP/2, the protocol of Ray's ports; a server responds with its settings (RFC 9113, 3.4)."""
_LOCAL = {
    "RAY_worker_niceness": "0",  # by default, actors yield to every other process (nice 15)
    "RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0",  # its processes listen on the loopback only
}
"""Environment of a local cluster."""
_ENDED_BY_RAY = (
    "robustflow: Ray ended this process, as it does when a Ray process on this machine is killed or runs out of "
    "memory; finished work is kept: run the same command again to continue"
)


def ray_module() -> Any:
    require("ray", "the ray engine")
    import ray

    return ray


@contextmanager
def connected(address: str | None, cpus: int | None = None, sent_bytes: int = 0) -> Iterator[Any]:
    """Yield the module `ray`, connected to a cluster; a connection or cluster started here ends with the block."""
    ray = ray_module()
    if ray.is_initialized():
        if address not in (None, "auto"):
            raise UsageError("--address", "this process is already connected to a Ray cluster: omit it, or disconnect")
        yield ray
        return
    handler = signal.getsignal(signal.SIGTERM)
    settings = {"RAY_USAGE_STATS_ENABLED": "0"}
    logger = logging.getLogger("ray")
    level = logger.level
    # there is no option to turn off messages about lost actors, which Ray prints to standard output, among our tables
    ray._private.worker._worker_logs_enabled = False
    usual = tempfile.gettempdir()
    with ExitStack() as stack:
        if address is None:
            folder = stack.enter_context(scratch_folder(usual if len(usual) <= _LONGEST_TMP else "/tmp"))
            settings |= _LOCAL | {"RAY_TMPDIR": folder}
        stack.enter_context(_watched(settings.get("RAY_TMPDIR")))  # a start takes seconds
        try:
            with safe_path(), environment_variables(settings):
                if address is None:
                    _start(ray, cpus, sent_bytes)
                else:
                    _join(ray, address)
            _restore(handler)  # Ray replaces the caller's handler
            yield ray
        finally:
            ray.shutdown()
            _restore(handler)
            logger.setLevel(level)
            ray._private.worker._worker_logs_enabled = True


def _start(ray: Any, cpus: int | None, sent_bytes: int) -> None:
    constants = ray._private.ray_constants
    many_machines, constants.ENABLE_RAY_CLUSTER = constants.ENABLE_RAY_CLUSTER, False  # listen on the loopback only
    try:
        ray.init(
            address="local",
            job_config=_job(ray),
            num_cpus=cpus,
            include_dashboard=False,
            object_store_memory=_STORE_BYTES + 2 * sent_bytes,
            log_to_driver=False,
            logging_level=logging.ERROR,
        )
    except Exception as error:
        raise RunError(
            f"Ray did not start on this machine within 30 s ({_first_sentence(error)}): try again when "
            "the machine is less busy, or use --engine processes"
        ) from error
    finally:
        constants.ENABLE_RAY_CLUSTER = many_machines


def _join(ray: Any, address: str) -> None:
    cluster = f"the Ray cluster at '{address}'"
    try:
        _check_answers(os.environ.get("RAY_ADDRESS", address) if address == "auto" else address, cluster)
        ray.init(address=address, job_config=_job(ray), log_to_driver=False, logging_level=logging.ERROR)
    except RobustFlowError:
        raise
    except ImportError as error:
        raise UsageError("--address", "ray:// needs Ray's client: pip install 'ray[client]'") from error
    except ValueError as error:
        raise UsageError("--address", f"'{address}' is invalid: use auto, host:port or ray://host:port") from error
    except SystemExit as error:  # Ray's error for a server with a different protocol
        raise _other_service(cluster) from error
    except Exception as error:
        raise RunError("--address", f"cannot connect to {cluster}: {_first_sentence(error)}") from error


@contextmanager
def _watched(folder: str | None) -> Iterator[None]:
    """Within the block, a second process watches this one, see `ray_watch`; `folder` is that of a local cluster."""
    arguments = [sys.executable, "-I", "-S", ray_watch.__file__, _ENDED_BY_RAY, *([folder] if folder else [])]
    # in a separate session, where Ctrl-C does not reach it
    watching = subprocess.Popen(arguments, stdin=subprocess.PIPE, start_new_session=True)
    assert watching.stdin is not None
    try:
        yield
    finally:
        with suppress(OSError):
            watching.stdin.write(b".")
            watching.stdin.close()
        watching.wait()


class _NoFolders(list[str]):
    """An empty list of folders that Ray puts before the standard library in its workers' module path."""

    def extend(self, folders: Iterable[str]) -> None:
        """Ignore the working directory and the script's folder, because Ray has no option to leave them out."""


def _job(ray: Any) -> Any:
    job = ray.job_config.JobConfig()
    job._py_driver_sys_path = _NoFolders()
    return job


def _check_answers(address: str, cluster: str) -> None:
    """Check the address first: Ray would retry for two minutes and then end the process."""
    host, colon, port = address.removeprefix("ray://").rpartition(":")
    if not (colon and host and port.isdecimal()):
        return
    try:
        with socket.create_connection((host.strip("[]"), int(port)), timeout=REACH_S) as connection:
            connection.sendall(_PREFACE)
            answer = connection.recv(9)
    except TimeoutError:
        answer = b""
    except (OSError, OverflowError) as error:
        raise RunError("--address", f"{cluster} cannot be reached ({error}); start it (ray start --head)") from error
    if answer[3:4] != _SETTINGS and not os.environ.get("RAY_USE_TLS"):
        raise _other_service(cluster)


def _other_service(cluster: str) -> RunError:
    return RunError("--address", f"{cluster} does not respond like one; check host and port")


def _restore(handler: Any) -> None:
    if handler is not None and signal.getsignal(signal.SIGTERM) is not handler:
        try:
            signal.signal(signal.SIGTERM, handler)
        except ValueError:  # not in the main thread, so Ray did not change the handler either
            return


def _first_sentence(error: Exception) -> str:
    return " ".join(str(error).split()).partition(". ")[0] or type(error).__name__
