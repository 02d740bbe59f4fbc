"""The gate before all routes: who may speak to the studio, limits of size, and the headers of every answer."""

import secrets
import time
from collections.abc import Awaitable, Callable, Mapping, MutableMapping
from dataclasses import dataclass, field
from http import HTTPStatus
from http.cookies import CookieError, SimpleCookie
from typing import Any
from urllib.parse import parse_qs, urlencode

from starlette.exceptions import HTTPException

# The rules for Host, Origin and Sec-Fetch-Site, tokens and cookies

HOSTS = frozenset({"127.0.0.1", "localhost", "[::1]"})
SAME_SITE = frozenset({"same-origin", "none"})


def host_allowed(host: str) -> bool:
    """Whether a Host header names this machine, whatever the port: a tunnel may map another one.

    Foreign names are refused because a page of theirs may point its own name at 127.0.0.1 (DNS rebinding).

    >>> [host_allowed(h) for h in ("127.0.0.1:8877", "[::1]:8877", "localhost", "evil.example", "127.0.0.1.evil.io")]
    [True, True, True, False, False]
    """
    end = host.find("]") + 1 if host.startswith("[") else host.find(":") if ":" in host else len(host)
    name, port = host[:end], host[end:]
    return name.lower() in HOSTS and (not port or (port[0] == ":" and port[1:].isdecimal() and len(port) <= 6))


def origin_allowed(origin: str | None, host: str) -> bool:
    """Whether a request comes from the studio's own page.

    >>> origin_allowed("http://localhost:8877", "localhost:8877"), origin_allowed(None, "localhost:8877")
    (True, False)
    """
    return origin is not None and origin.lower() == f"http://{host}".lower()


@dataclass(eq=False)
class AccessTokens:
    """Tokens for the printed link, each good once and for ten minutes, and the cookies into which they turn.

    Args:
        port: Of the server: cookies ignore ports, so that two studios would share a name.
        clock: Seconds.
    """

    port: int
    clock: Callable[[], float] = time.monotonic
    _tokens: dict[str, float] = field(default_factory=dict)
    _sessions: set[str] = field(default_factory=set)

    @property
    def cookie(self) -> str:
        """Name of the cookie."""
        return f"farfield_{self.port}"

    def new_token(self) -> str:
        """A token for a link."""
        token = secrets.token_urlsafe(32)
        self._tokens[token] = self.clock() + TOKEN_S
        return token

    def admit(self, token: str) -> str | None:
        """Turn a token into a session, which is the cookie's value; None if it was used, is too old or was never."""
        now, match = self.clock(), None
        for issued in list(self._tokens):
            if secrets.compare_digest(issued.encode(), token.encode("utf-8", "replace")):
                match = issued
        until = self._tokens.pop(match) if match is not None else now
        self._tokens = {issued: end for issued, end in self._tokens.items() if end > now}
        if until <= now:
            return None
        session = secrets.token_urlsafe(32)
        self._sessions.add(session)
        return session

    def admitted(self, cookies: str) -> bool:
        """Whether a Cookie header holds one of the sessions."""
        value = _cookie(cookies, self.cookie).encode("utf-8", "replace")
        return any(secrets.compare_digest(session.encode(), value) for session in self._sessions)

    def set_cookie(self, session: str) -> str:
        """Value of the Set-Cookie header."""
        return f"{self.cookie}={session}; Path=/; HttpOnly; SameSite=Strict"


def _cookie(text: str, name: str) -> str:
    try:
        morsel = SimpleCookie(text).get(name)
    except CookieError:
        return ""
    return "" if morsel is None else morsel.value


def refusal(method: str, headers: Mapping[str, list[str]], *, socket: bool = False) -> tuple[int, str] | None:
    """Why a request is refused before anything of it is looked at: status and sentence; None if it is not.

    Args:
        method: ``GET``, ``POST``...
        headers: Values by name in lower case.
        socket: Whether a WebSocket is to be opened: a foreign page may try, and the browser lets it.
    """
    hosts = headers.get("host", [])
    if len(hosts) != 1 or not host_allowed(hosts[0]):
        return 421, "This server answers on 127.0.0.1, localhost and [::1] only."
    origin = headers.get("origin", [None])[0]
    if (socket or method not in ("GET", "HEAD") or origin is not None) and not origin_allowed(origin, hosts[0]):
        return 403, "This request comes from another page than the studio's own."
    site = headers.get("sec-fetch-site", ["none"])[0]
    if site not in SAME_SITE:
        return 403, "This request comes from another site."
    return None


BODY_BYTES = 8 << 20
"""Longest body of a request."""
_LENGTH_DIGITS = 10
TOKEN_S = 600.0
"""How long a link may be used."""
Scope = MutableMapping[str, Any]
Message = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[Message]]
Send = Callable[[Message], Awaitable[None]]
App = Callable[[Scope, Receive, Send], Awaitable[None]]

POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; connect-src 'self'; "
    "worker-src 'self' blob:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
HEADERS = (
    (b"content-security-policy", POLICY.encode()),
    (b"x-content-type-options", b"nosniff"),
    (b"referrer-policy", b"no-referrer"),
    (b"cross-origin-opener-policy", b"same-origin"),
    (b"cross-origin-resource-policy", b"same-origin"),
)
OPEN = ("/health",)
"""Paths for which nobody needs a cookie."""
USED = (
    "This link was used before, or is older than ten minutes. Press Enter in the terminal in which the studio runs "
    "for a new one."
)


class Guard:
    """An ASGI application before another: what is not allowed never reaches it.

    Args:
        app: The application.
        entry: Tokens and cookies.
    """

    def __init__(self, app: App, entry: AccessTokens) -> None:
        self.app, self.entry = app, entry

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Refuse, admit or pass on."""
        if scope["type"] == "lifespan":
            await self.app(scope, receive, send)
        elif scope["type"] == "websocket":
            await self._socket(scope, receive, send)
        else:
            await self._request(scope, receive, _HeaderSender(send))

    async def _socket(self, scope: Scope, receive: Receive, send: Send) -> None:
        headers = _headers(scope)
        refused = refusal("GET", headers, socket=True)
        if refused or scope["path"] != "/socket" or not self.entry.admitted("; ".join(headers.get("cookie", []))):
            await receive()
            await send({"type": "websocket.close", "code": 1008, "reason": ""})  # before accepting: status 403
            return
        await self.app(scope, receive, send)

    async def _request(self, scope: Scope, receive: Receive, send: Send) -> None:
        headers, path, method = _headers(scope), scope["path"], scope["method"]
        if method == "GET" and path == "/" and _linked(headers):
            query = parse_qs(scope["query_string"].decode("latin-1")).get("frame", [""])[0]
            await answer(send, 200, _bounce(query), kind="text/html; charset=utf-8")
            return
        refused = refusal(method, headers)
        if refused:
            await answer(send, *refused)
            return
        if method == "GET" and path == "/" and b"token=" in scope["query_string"]:
            await self._admit(scope, send)
            return
        if path not in OPEN and not self.entry.admitted("; ".join(headers.get("cookie", []))):
            await answer(send, 403, f"This window was not let in. {USED}")
            return
        length = headers.get("content-length", ["0"])[0]
        if not length.isdecimal() or len(length) > _LENGTH_DIGITS or int(length) > BODY_BYTES:
            await answer(send, 413, _too_large())
            return
        await self.app(scope, _BoundedBody(receive), send)

    async def _admit(self, scope: Scope, send: Send) -> None:
        query = parse_qs(scope["query_string"].decode("latin-1"))
        session = self.entry.admit(query["token"][0]) if query.get("token") else None
        if session is None:
            await answer(send, 403, USED)
            return
        rest = {name: values[0] for name, values in query.items() if name in ("frame", "test")}
        where = "/" + ("?" + urlencode(rest) if rest else "")
        more = [(b"location", where.encode()), (b"set-cookie", self.entry.set_cookie(session).encode())]
        await answer(send, 303, "", more=more)


def _too_large() -> str:
    return f"This is longer than the {BODY_BYTES >> 20} MiB that are taken."


def _headers(scope: Scope) -> dict[str, list[str]]:
    values: dict[str, list[str]] = {}
    for name, value in scope["headers"]:
        values.setdefault(name.decode("latin-1").lower(), []).append(value.decode("latin-1"))
    return values


def _linked(headers: dict[str, list[str]]) -> bool:
    """Whether a person followed a link of another page, such as a report, to the studio's own page."""
    return (
        headers.get("sec-fetch-site", [""])[0] in ("cross-site", "same-site")
        and headers.get("sec-fetch-mode", [""])[0] == "navigate"
        and headers.get("sec-fetch-dest", [""])[0] == "document"
        and "origin" not in headers
        and refusal("GET", {"host": headers.get("host", [])}) is None
    )


def _bounce(frame: str) -> str:
    """A page that opens the studio's page from itself: a strict cookie does not follow a link of another page."""
    where = "/?" + urlencode({"frame": frame}) if frame else "/"
    return f'<!doctype html><meta http-equiv="refresh" content="0;url={where}"><title>Farfield</title>'


async def answer(
    send: Send,
    status: int,
    text: str,
    *,
    kind: str = "text/plain; charset=utf-8",
    more: list[tuple[bytes, bytes]] | None = None,
) -> None:
    """Answer a request with a sentence."""
    body = (text or HTTPStatus(status).phrase).encode()
    headers = [(b"content-type", kind.encode()), (b"content-length", str(len(body)).encode()), *(more or [])]
    headers.append((b"cache-control", b"no-store"))
    await send({"type": "http.response.start", "status": status, "headers": headers})
    await send({"type": "http.response.body", "body": body})


class _HeaderSender:
    """Sends answers with the headers that all of them carry."""

    def __init__(self, send: Send) -> None:
        self.send = send

    async def __call__(self, message: Message) -> None:
        if message["type"] == "http.response.start":
            message = {**message, "headers": [*message.get("headers", ()), *HEADERS]}
        await self.send(message)


class _BoundedBody:
    """Receives a body up to what is taken."""

    def __init__(self, receive: Receive) -> None:
        self.receive, self.bytes = receive, 0

    async def __call__(self) -> Message:
        message = await self.receive()
        self.bytes += len(message.get("body", b""))
        if self.bytes > BODY_BYTES:
            raise HTTPException(413, _too_large())
        return message
