"""Who may speak to the studio: the rules for Host, Origin and Sec-Fetch-Site, tokens and cookies."""

import secrets
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from http.cookies import CookieError, SimpleCookie

from farfield.studio.serving.limits import TOKEN_S

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
        now, found = self.clock(), None
        for known in list(self._tokens):
            if secrets.compare_digest(known.encode(), token.encode("utf-8", "replace")):
                found = known
        until = self._tokens.pop(found) if found is not None else now
        self._tokens = {known: end for known, end in self._tokens.items() if end > now}
        if until <= now:
            return None
        session = secrets.token_urlsafe(32)
        self._sessions.add(session)
        return session

    def admitted(self, cookies: str) -> bool:
        """Whether a Cookie header holds one of the sessions."""
        given = _cookie(cookies, self.cookie).encode("utf-8", "replace")
        return any(secrets.compare_digest(known.encode(), given) for known in self._sessions)

    def set_cookie(self, session: str) -> str:
        """Value of the Set-Cookie header."""
        return f"{self.cookie}={session}; Path=/; HttpOnly; SameSite=Strict"


def _cookie(text: str, name: str) -> str:
    try:
        found = SimpleCookie(text).get(name)
    except CookieError:
        return ""
    return "" if found is None else found.value


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
