"""Every refusal of the studio's server, each against a server that really listens."""

import contextlib
import json
import logging
import re
import socket

import pytest

pytest.importorskip("starlette")
pytest.importorskip("uvicorn")
from studio.live import Live, studio
from websockets.exceptions import ConnectionClosed, InvalidStatus

from farfield.studio.messages.rows import VERSION
from farfield.studio.serving import app, guard, run
from farfield.studio.serving.guard import AccessTokens, host_allowed


@pytest.fixture(scope="module")
def live():
    with studio() as running:
        yield running


def test_health_needs_no_cookie_and_tells_nothing_of_the_data(live: Live):
    status, headers, body = live.get("/health", cookie="")
    assert status == 200
    assert json.loads(body) == {"status": "ok", "version": VERSION, "ready": True}
    assert "server" not in headers


@pytest.mark.parametrize(
    ("host", "status"),
    [
        ("127.0.0.1:1", 200),  # a tunnel may map another port
        ("localhost:8877", 200),
        ("LOCALHOST", 200),
        ("[::1]:8877", 200),
        ("evil.example:8877", 421),
        ("127.0.0.1.evil.example", 421),
        ("127.0.0.1@evil.example", 421),
        ("localhost:80:80", 421),
        ("[::1", 421),
        ("0.0.0.0", 421),
    ],
)
def test_host(live: Live, host, status):
    assert live.get("/health", host=host)[0] == status
    assert host_allowed(host) == (status == 200)


def test_a_request_without_host_is_refused(live: Live):
    with socket.create_connection(("127.0.0.1", live.port)) as raw:
        raw.sendall(b"GET /health HTTP/1.0\r\n\r\n")
        assert b" 421 " in raw.recv(4096).split(b"\r\n")[0]


@pytest.mark.parametrize("origin", ["", "null", "http://evil.example", "https://{host}", "http://localhost:1"])
def test_a_post_of_another_origin_is_refused(live: Live, origin):
    assert live.request("POST", "/shot", b"x", origin=origin.format(host=live.host))[0] == 403


@pytest.mark.parametrize("origin", ["null", "http://evil.example", "http://localhost:1"])
def test_a_get_of_another_origin_is_refused(live: Live, origin):
    assert live.get("/layer/0/0", origin=origin)[0] == 403


@pytest.mark.parametrize(
    ("site", "status"), [("same-origin", 200), ("none", 200), ("cross-site", 403), ("same-site", 403)]
)
def test_sec_fetch_site(live: Live, site, status):
    assert live.get("/layer/0/0", sec_fetch_site=site)[0] == status


@pytest.mark.parametrize(
    "change",
    [
        {"origin": "http://evil.example"},
        {"origin": ""},
        {"origin": "null"},
        {"cookie": ""},
        {"cookie": "farfield_1=x"},
        {"Sec-Fetch-Site": "cross-site"},
    ],
)
def test_a_foreign_websocket_is_refused_before_it_opens(live: Live, change):
    with pytest.raises(InvalidStatus, match="403"), live.raw(**change):
        pass


@pytest.mark.parametrize(
    ("host", "origin", "status"),
    [
        ("{host}", "http://{host}", 101),
        ("localhost:1", "http://localhost:1", 101),
        ("[::1]:8877", "http://[::1]:8877", 101),
        ("evil.example", "http://evil.example", 403),
        ("{host}", "http://localhost:1", 403),
    ],
)
def test_a_websocket_of_another_host_is_refused(live: Live, host, origin, status):
    with socket.create_connection(("127.0.0.1", live.port), timeout=10) as raw:
        head = (
            f"GET /socket HTTP/1.1\r\nHost: {host}\r\nOrigin: {origin}\r\nCookie: {live.cookie}\r\n"
            "Connection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\n"
            "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n"
        )
        raw.sendall(head.replace("{host}", live.host).encode())
        assert raw.recv(4096).startswith(f"HTTP/1.1 {status} ".encode())


def test_a_websocket_elsewhere_is_refused(live: Live):
    from websockets.sync.client import connect

    with (
        pytest.raises(InvalidStatus, match="403"),
        connect(f"ws://{live.host}/elsewhere", origin=live.origin, additional_headers={"Cookie": live.cookie}),
    ):
        pass


@pytest.mark.parametrize("path", ["/", "/layer/0/0", "/image/0/2", "/radar/1/bev", "/studio.js", "/export/1", "/no"])
def test_nothing_is_shown_without_the_cookie(live: Live, path):
    status, _, body = live.get(path, cookie="")
    assert status == 403
    assert b"Press Enter in the terminal" in body


def test_the_link_is_good_once(live: Live):
    status, _, body = live.get(f"/?token={live.token()}", cookie="")
    assert (status, b"used before" in body) == (403, True)
    assert live.get("/?token=" + "x" * 43, cookie="")[0] == 403
    assert live.get("/?token=", cookie="")[0] == 403


def test_a_token_turns_into_a_strict_cookie_and_keeps_the_frame():
    with studio() as running:
        name = f"farfield_{running.port}"
        assert running.cookie.startswith(name + "=")
        assert len(running.cookie) > len(name) + 40
    entry = AccessTokens(1)
    assert entry.set_cookie("s") == "farfield_1=s; Path=/; HttpOnly; SameSite=Strict"


def test_a_token_dies_after_ten_minutes_and_after_its_use():
    now = [0.0]
    entry = AccessTokens(1, clock=lambda: now[0])
    first, second = entry.new_token(), entry.new_token()
    assert len(first) >= 43
    now[0] = guard.TOKEN_S - 1
    session = entry.admit(first)
    assert session is not None
    assert entry.admitted(f"a=b; farfield_1={session}")
    assert not entry.admitted(f"farfield_2={session}")
    assert entry.admit(first) is None
    now[0] = guard.TOKEN_S + 1
    assert entry.admit(second) is None
    assert entry.admitted(f"farfield_1={session}")  # who is in stays in


def test_every_answer_carries_the_policy(live: Live):
    for path, cookie in (("/health", ""), ("/", ""), ("/layer/0/0", live.cookie), ("/nothing", live.cookie)):
        _, headers, _ = live.get(path, cookie=cookie)
        policy = dict(part.strip().split(" ", 1) for part in headers["content-security-policy"].split(";"))
        assert policy["default-src"] == "'none'"
        assert policy["script-src"] == policy["style-src"] == policy["connect-src"] == "'self'"
        assert policy["frame-ancestors"] == policy["base-uri"] == policy["form-action"] == "'none'"
        assert headers["x-content-type-options"] == "nosniff"
        assert headers["referrer-policy"] == "no-referrer"
        assert headers["cross-origin-opener-policy"] == headers["cross-origin-resource-policy"] == "same-origin"


@pytest.mark.parametrize(
    "path",
    [
        "/../pyproject.toml",
        "/..%2f..%2fmessages%2fbase.py",
        "/%2e%2e/serving/run.py",
        "/static/../run.py",
        "/layer/0/..%2f..%2f",
        "/layer/0/99",
        "/layer/99/0",
        "/layer/-1/0",
        "/image/0/0",
        "/radar/0/bev",
        "/radar/1/side",
        "/export/..%2f..%2fetc%2fpasswd",
        "/etc/passwd",
    ],
)
def test_there_is_nothing_but_frames_and_layers_by_number(live: Live, path):
    status, _, body = live.get(path)
    assert status == 404
    assert b"/" + b"src" not in body
    assert b"Traceback" not in body


def test_a_body_beyond_8_mib_is_refused(live: Live):
    told = {"origin": live.origin, "content_length": str(guard.BODY_BYTES + 1)}
    with contextlib.suppress(BrokenPipeError, ConnectionError):
        assert live.request("POST", "/shot", b"", **told)[0] == 413
    assert live.request("POST", "/shot", b"", origin=live.origin, content_length="x")[0] in (400, 413)


def test_a_body_without_length_is_counted(live: Live):
    with socket.create_connection(("127.0.0.1", live.port)) as raw:
        head = (
            f"POST /shot HTTP/1.1\r\nHost: {live.host}\r\nOrigin: {live.origin}\r\nCookie: {live.cookie}\r\n"
            "Transfer-Encoding: chunked\r\n\r\n"
        )
        raw.sendall(head.encode())
        piece = b"100000\r\n" + b"x" * 0x100000 + b"\r\n"
        with contextlib.suppress(ConnectionError):
            for _ in range(12):
                raw.sendall(piece)
        assert b" 413 " in raw.recv(4096).split(b"\r\n")[0]


def test_a_message_beyond_1_mib_closes_the_window(live: Live):
    with live.window() as client:
        client.socket.send("x" * (run.MESSAGE_BYTES + 1))
        with pytest.raises(ConnectionClosed) as closed:
            client.until("never")
        assert closed.value.rcvd is not None
        assert closed.value.rcvd.code == 1009


def test_the_ninth_window_is_sent_away(live: Live):
    with contextlib.ExitStack() as stack:
        for _ in range(app.WINDOWS):
            stack.enter_context(live.window())
        with live.raw() as ninth:
            ninth.send(json.dumps({"op": "hello", "window": "ninth"}))
            said = json.loads(ninth.recv(timeout=10))
            assert said["op"] == "bye"
            assert "8 windows" in said["reason"]


@pytest.mark.parametrize(
    ("first", "reason"),
    [
        ('{"op":"frame.open","frame":0}', "hello"),
        ("nonsense", "hello"),
        ('{"op":"hello","window":"w","version":1}', "version"),
        ('{"op":"hello","window":"../w"}', "hello"),
    ],
)
def test_a_window_that_does_not_say_hello_is_sent_away(live: Live, first, reason):
    with live.raw() as raw:
        raw.send(first)
        said = json.loads(raw.recv(timeout=10))
        assert (said["op"], reason in said["reason"]) == ("bye", True)


def test_bytes_are_no_hello(live: Live):
    with live.raw() as raw:
        raw.send(b"\x00")
        assert json.loads(raw.recv(timeout=10))["op"] == "bye"


def test_a_window_that_says_hello_late_may_come_again(live: Live, monkeypatch):
    monkeypatch.setattr(app, "_HELLO_S", 0.05)
    with live.raw() as late, pytest.raises(ConnectionClosed) as closed:
        late.recv(timeout=20)  # no goodbye, after which the page would not come again
    assert closed.value.rcvd.code == 1013


def test_a_client_that_goes_away_in_its_body_is_no_error_of_the_studio(live: Live, monkeypatch):
    failures = []
    monkeypatch.setattr(logging.getLogger("uvicorn.error"), "error", lambda *_, **more: failures.append(more))
    head = f"POST /shot HTTP/1.1\r\nHost: {live.host}\r\nOrigin: {live.origin}\r\nCookie: {live.cookie}\r\n"
    for _ in range(3):
        with socket.create_connection(("127.0.0.1", live.port), timeout=10) as raw:
            raw.sendall(head.encode() + b"Content-Length: 500\r\n\r\nonly this")
            raw.shutdown(socket.SHUT_WR)
            raw.recv(100)
    assert live.get("/health")[0] == 200
    assert failures == []


def test_messages_that_are_none_are_refused_and_then_the_window_is_closed(live: Live):
    with live.window() as client:
        for number in range(app.BAD_MESSAGES):
            client.socket.send('{"op":"shell","command":"ls"}' if number % 2 else b"\x00\x01")
            assert client.until("refused")["code"] == "message"
        assert "reload" in client.until("bye")["reason"]
        with pytest.raises(ConnectionClosed):
            client.until("never")


def test_edits_are_refused_where_only_is_shown(live: Live):
    with live.window() as client:
        value = {"box": [1, 2, 3, 4, 2, 1.5, 0], "class_name": "vehicle"}
        client.send(op="box.set", id="e1", frame=0, box="0", base=0, value=value)
        refused = client.until("refused")
        assert (refused["id"], refused["code"]) == ("e1", "view")
        assert "farfield annotate" in refused["mend"]


def test_a_flood_of_edits_is_refused(live: Live, monkeypatch):
    monkeypatch.setattr(app, "EDITS_AT_ONCE", 5)
    with live.window() as client:
        for _ in range(50):
            client.send(op="undo", id="u")
        refused = client.until("refused", wanted=lambda m: m["code"] == "rate")
        assert "second" in refused["mend"]


def test_the_bucket_holds_a_burst_and_fills_at_200_a_second():
    now = [0.0]
    bucket = app.Bucket(clock=lambda: now[0])
    assert sum(bucket.take() for _ in range(5000)) == app.EDITS_AT_ONCE
    now[0] = 0.5
    assert sum(bucket.take() for _ in range(5000)) == 100


def test_a_frame_that_is_not_there_is_refused_in_words(live: Live):
    with live.window() as client:
        refused = client.open(7)
        assert refused["op"] == "refused"
        assert "from 0 to 1" in refused["sentence"]


def test_a_followed_link_of_a_report_opens_the_page_from_itself(live: Live):
    told = {"sec_fetch_site": "cross-site", "sec_fetch_mode": "navigate", "sec_fetch_dest": "document"}
    status, _, body = live.get("/?frame=cirrus-segment_00/16&token=x", cookie="", **told)
    assert status == 200
    assert b'content="0;url=/?frame=cirrus-segment_00%2F16"' in body
    hostile = live.get('/?frame="><script>alert(1)</script>', cookie="", **told)[2]
    assert b"<script" not in hostile
    assert live.get("/layer/0/0", **told)[0] == 403
    assert live.get("/", host="evil.example", **told)[0] == 421
    assert live.get("/", cookie="", **{**told, "sec_fetch_dest": "iframe"})[0] == 403


def test_no_answer_shows_a_path_of_this_machine(live: Live):
    with live.window() as client:
        texts = [json.dumps(client.welcome), json.dumps(client.open(0)), json.dumps(client.open(1))]
    for text in texts:
        assert not re.search(r'"[^"]*?/(?:home|root|work|tmp|usr)/', text)


@pytest.mark.parametrize("digits", [10, 20, 5000])
def test_a_number_of_many_digits_is_nothing_that_is_there(live: Live, digits: int):
    """int() takes no more than 4,300 of them."""
    many = "9" * digits
    for path in ("/layer/{}/0", "/layer/0/{}", "/image/{}/0", "/image/0/{}", "/radar/{}/bev", "/export/{}", "/{}"):
        assert live.get(path.format(many))[0] == 404, path
    assert live.get(f"/?frame={many}")[0] == 200
    assert live.get(f"/?frame={many}/{many}")[0] == 303
    assert live.get(f"/layer/0/0?sweeps={many}")[0] == 200
    assert live.request("POST", "/shot", b"", origin=live.origin, content_length=many)[0] in (400, 413)
    assert live.get("/layer/0/0")[0] == 200
