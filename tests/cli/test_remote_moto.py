"""S3 as moto's server speaks it, where that is installed: ``pip install moto flask flask-cors``."""

import logging
import os
import signal
import subprocess
import sys
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import pytest

from farfield.datasets.open_sweeps import ROOT

pytest.importorskip("obstore")
pytest.importorskip("flask_cors")
server = pytest.importorskip("moto.server")

pytestmark = pytest.mark.slow


@pytest.fixture
def environment(tmp_path: Path) -> Iterator[dict[str, str]]:
    """Moto's server with an empty bucket, and the variables of a client."""
    logging.getLogger("werkzeug").setLevel(logging.ERROR)
    moto = server.ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    moto.start()
    url = f"http://127.0.0.1:{moto.get_host_and_port()[1]}"
    urllib.request.urlopen(urllib.request.Request(f"{url}/bucket", method="PUT")).close()
    yield {
        **os.environ,
        "AWS_ACCESS_KEY_ID": "key",
        "AWS_SECRET_ACCESS_KEY": "secret",
        "AWS_REGION": "us-east-1",
        "AWS_ENDPOINT_URL": url,
        "AWS_ALLOW_HTTP": "true",
        "XDG_CACHE_HOME": str(tmp_path / "cache"),
    }
    moto.stop()


def farfield(environment: dict[str, str], folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "farfield.cli", *words]
    return subprocess.run(command, env=environment, cwd=folder, capture_output=True, text=True, check=False)


def tree(folder: Path) -> dict[str, bytes]:
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file() and not path.name.startswith(".farfield") and "CARD" not in path.name
    }


def test_a_conversion_killed_in_the_middle_of_its_upload_goes_on(environment: dict[str, str], tmp_path: Path) -> None:
    sweeps = str(ROOT)
    done = farfield(environment, tmp_path, "convert", sweeps, "plain", "--to", "sustechpoints")
    assert done.returncode == 0, done.stderr
    words = ("convert", sweeps, "s3://bucket/store", "--to", "sustechpoints")
    running = subprocess.Popen(
        [sys.executable, "-m", "farfield.cli", *words],
        env=environment,
        cwd=tmp_path,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    listing = f"{environment['AWS_ENDPOINT_URL']}/bucket?list-type=2"
    until = time.monotonic() + 120
    while b"<Key>" not in urllib.request.urlopen(listing).read() and running.poll() is None:
        assert time.monotonic() < until
    running.send_signal(signal.SIGKILL)
    running.wait()
    done = farfield(environment, tmp_path, *words)
    assert done.returncode == 0, done.stderr
    done = farfield(environment, tmp_path, "convert", "s3://bucket/store", "again", "--to", "boxes-csv")
    assert done.returncode == 0, done.stderr
    assert b".farfield-upload" not in urllib.request.urlopen(listing).read()
    assert b"<Upload>" not in urllib.request.urlopen(f"{environment['AWS_ENDPOINT_URL']}/bucket?uploads").read()
    fetch = (
        "import sys; from pathlib import Path; from farfield.files.remote_paths import as_path\n"
        "root, out = as_path('s3://bucket/store'), Path('fetched')\n"
        "for path in root.rglob('*'):\n"
        "    if path.is_file():\n"
        "        target = out / path.relative_to(root).as_posix(); target.parent.mkdir(parents=True, exist_ok=True)\n"
        "        target.write_bytes(path.read_bytes())\n"
    )
    subprocess.run([sys.executable, "-c", fetch], env=environment, cwd=tmp_path, check=True)
    assert tree(tmp_path / "fetched") == tree(tmp_path / "plain")
    assert len(tree(tmp_path / "fetched")) > 12
