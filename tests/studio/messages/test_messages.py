import json
import subprocess
import sys
from pathlib import Path
from typing import get_args

import pytest

pytest.importorskip("pydantic")
from farfield.errors import ConfigError
from farfield.studio.messages.replies import Ack, Job, write_reply
from farfield.studio.messages.requests import BoxSet, Hello, Request, id_of, read_request

VALUE = {"box": [10, 2.5, 0.8, 4.6, 1.9, 1.7, 0.3], "class_name": "vehicle", "track": 3}
SET = {"op": "box.set", "id": "w1-1", "frame": 0, "box": "b1", "base": 2, "value": VALUE}


def changed(**parts):
    return json.dumps({**SET, **parts})


def valued(**parts):
    return changed(value={**VALUE, **parts})


def test_a_message_is_read_into_its_class():
    read = read_request(changed())
    assert isinstance(read, BoxSet)
    assert read.value.box == (10, 2.5, 0.8, 4.6, 1.9, 1.7, 0.3)
    assert (read.value.track, read.value.state, read.base) == (3, "edited", 2)


@pytest.mark.parametrize("value", [float("nan"), "\ud800", 10**30, [[[1]]], None])
def test_whatever_is_refused_is_named_by_its_id(value):
    text = valued(attributes={"a": value}, box=[value])
    with pytest.raises(ConfigError):
        read_request(text)
    assert id_of(text) == "w1-1"  # without it the page would send the edit again and again


def test_digits_without_end_do_not_hide_the_id():
    assert id_of(changed().replace('"frame": 0', f'"frame": {"9" * 5000}')) == "w1-1"
    assert id_of("[" * 100_000) is id_of('{"id": "../x"}') is id_of("5") is id_of(b"\xff") is None


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("", "expected JSON"),
        ("[1]", "message"),
        ('{"op": "shell"}', "message"),
        ('{"id": "x"}', "message"),
        (changed(extra=1), "extra"),
        (changed(frame="0"), "frame"),
        (changed(frame=-1), "frame"),
        (changed(frame=1.5), "frame"),
        (changed(id="x" * 65), "id"),
        (changed(id="../x"), "id"),
        (changed(base=2**60), "base"),
        (valued(box=[10, 2, 0.8, 4.6, 1.9, 1.7]), "box"),
        (valued(box=[10, 2, 0.8, 4.6, 1.9, 0, 0]), "box"),
        (valued(box=[10, 2, 0.8, 60.1, 1.9, 1, 0]), "box"),
        (valued(box=[1001, 2, 0.8, 4.6, 1.9, 1, 0]), "box"),
        (valued(box=[10, 2, 0.8, 4.6, 1.9, 1, float("nan")]), "box"),
        (valued(box=[10, 2, 0.8, 4.6, 1.9, 1, float("inf")]), "box"),
        (valued(state="sold"), "state"),
        (valued(track=-1), "track"),
        (valued(attributes={"a": [1]}), "attributes"),
        (valued(attributes={"a": float("nan")}), "attributes"),
        (valued(attributes={"a": "x" * 2001}), "attributes"),
        (valued(attributes={str(i): 1 for i in range(65)}), "attributes"),
    ],
)
def test_what_is_no_such_message_is_refused_by_the_name_of_its_field(text, part):
    with pytest.raises(ConfigError, match=part):
        read_request(text)


def test_replies_are_json_without_nan():
    text = write_reply(Ack(id="a", seq=1, version=2, saved_ns=str(1_600_000_000_000_000_001)))
    assert json.loads(text)["saved_ns"] == "1600000000000000001"
    with pytest.raises(ValueError, match="Out of range"):
        write_reply(Job(id="a", job="j", kind="infer", state="running", eta_s=float("nan")))


def test_the_page_has_the_types_of_today():
    root = Path(__file__).parents[3]
    if not (root / "web" / "src" / "protocol.ts").exists():
        pytest.skip("no web/ beside these tests")
    command = [sys.executable, str(root / "tools" / "page_protocol.py")]
    types = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    stored = (root / "web" / "src" / "protocol.ts").read_text()
    assert stored == types, "run: python tools/page_protocol.py > web/src/protocol.ts"


def test_every_message_but_the_first_has_a_handler():
    pytest.importorskip("starlette")
    from farfield.studio.serving.app import HANDLER_MODULES
    from farfield.studio.session.session import HANDLERS

    assert len(HANDLER_MODULES) == 7
    assert set(HANDLERS) == {*get_args(get_args(Request)[0])} - {Hello}
