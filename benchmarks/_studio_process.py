"""A studio as a user starts it: the command in a process of its own, entered by its printed link."""

import contextlib
import http.client
import re
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass


@dataclass(frozen=True)
class Started:
    """A running studio.

    Args:
        origin: Scheme, host and port.
        cookie: What its link gave.
    """

    origin: str
    cookie: str


@contextlib.contextmanager
def started(verb: str, *arguments: str) -> Iterator[Started]:
    """Run ``farfield view`` or ``annotate`` without a browser, and end it.

    Raises:
        RuntimeError: If it ends without a link.
    """
    command = [sys.executable, "-m", "farfield.cli", verb, *arguments, "--no-browser"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as process:
        try:
            yield _entered(process)
        finally:
            process.terminate()


def _entered(process: "subprocess.Popen[str]") -> Started:
    assert process.stdout is not None
    said = ""
    for line in process.stdout:
        said += line
        found = re.search(r"http://([\w.:]+)/\?token=(\S+)", line)
        if found:
            host, token = found.groups()
            connection = http.client.HTTPConnection(host, timeout=30)
            connection.request("GET", f"/?token={token}")
            cookie = str(connection.getresponse().getheader("set-cookie"))
            connection.close()
            return Started(f"http://{host}", cookie.partition(";")[0])
    raise RuntimeError(f"the studio ended without a link:\n{said}")
