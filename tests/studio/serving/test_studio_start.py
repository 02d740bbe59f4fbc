import contextlib
import io
import os
import re
import subprocess
import sys
import time
import urllib.request
from pathlib import Path

import pytest

pytest.importorskip("starlette")
pytest.importorskip("uvicorn")
from studio.live import studio

from farfield.datasets import open_dataset
from farfield.errors import ConfigError, FarfieldError
from farfield.studio.options import DatasetOpener
from farfield.studio.serving import run
from farfield.studio.serving.guard import AccessTokens
from farfield.vocabulary.studio import STUDIO_PORT


def test_a_port_that_is_taken_is_named_and_without_one_the_next_is_taken():
    with contextlib.closing(run.listening(0)) as taken:
        port = taken.getsockname()[1]
        assert taken.getsockname()[0] == "127.0.0.1"
        with pytest.raises(ConfigError, match=f"port {port} is taken.*--port"):
            run.listening(port)
    with contextlib.closing(run.listening(None)) as first, contextlib.closing(run.listening(None)) as second:
        assert STUDIO_PORT <= first.getsockname()[1] < second.getsockname()[1]


def test_the_terminal_shows_a_link_and_over_ssh_the_tunnel(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.delenv("SSH_CONNECTION", raising=False)
    entry = AccessTokens(8877)
    words = run._words(entry)
    assert re.fullmatch(r"farfield studio: http://127\.0\.0\.1:8877/\?token=[\w-]{43}", words[0])
    monkeypatch.setenv("SSH_CONNECTION", "203.0.113.5 50000 192.0.2.7 22")
    monkeypatch.setenv("USER", "kim")
    assert run._words(entry)[0].endswith("ssh -N -L 8877:127.0.0.1:8877 kim@192.0.2.7")


@pytest.mark.parametrize(("remote", "opened"), [("", 1), ("203.0.113.5 50000 192.0.2.7 22", 0)])
def test_the_browser_is_opened_but_not_over_ssh(monkeypatch: pytest.MonkeyPatch, remote, opened):
    links: list[str] = []
    monkeypatch.setattr(run.webbrowser, "open", links.append)
    monkeypatch.setenv("SSH_CONNECTION", remote)
    with studio(browser=True) as running:
        deadline = time.monotonic() + 5
        while opened and not links and time.monotonic() < deadline:
            time.sleep(0.02)
        assert len(links) == opened
        assert all(link.startswith(f"http://127.0.0.1:{running.port}/?token=") for link in links)


def test_what_cannot_be_opened_ends_the_studio_with_its_reason(tmp_path: Path):
    with pytest.raises(FarfieldError, match="recognised no data set"), studio(DatasetOpener(tmp_path, open_dataset)):
        pass


def test_a_frame_that_is_not_there_ends_the_studio(tmp_path: Path):
    with pytest.raises(ConfigError, match="expected a number below 2"), studio(first="7", notes=tmp_path):
        pass


@pytest.mark.parametrize("verb", ["view", "annotate"])
def test_the_verb_listens_and_ends_with_ctrl_c(tmp_path: Path, verb):
    environment = os.environ | {"XDG_DATA_HOME": str(tmp_path), "SSH_CONNECTION": ""}
    command = [sys.executable, "-m", "farfield.cli", verb, "--no-browser", "--port", "0"]
    with subprocess.Popen(
        command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        try:
            line = process.stdout.readline()
            port = int(re.search(r"127\.0\.0\.1:(\d+)/", line)[1])
            with urllib.request.urlopen(f"http://127.0.0.1:{port}/health", timeout=20) as answer:
                assert answer.status == 200
            time.sleep(1.0)
            process.send_signal(2)
            assert process.wait(30) == 0, process.stderr.read()
        finally:
            process.kill()


def test_enter_prints_a_new_link(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(run.sys, "stdin", io.StringIO("\n"))
    lines: list[str] = []
    run._new_link(AccessTokens(1), lines.append)
    assert lines[0].startswith("http://127.0.0.1:1/?token=")
