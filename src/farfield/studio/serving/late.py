"""Listening before anything heavy is imported: what is asked meanwhile waits, and ``/health`` says how far it is."""

import asyncio
import json

from farfield.studio.serving.guard import App, Receive, Scope, Send, answer


class DeferredApp:
    """An application that comes later."""

    def __init__(self) -> None:
        self._app: App | None = None
        self._there = asyncio.Event()

    def take(self, app: App) -> None:
        """Pass everything on to an application from now on."""
        self._app = app
        self._there.set()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Wait for the application, then let it answer."""
        if self._app is None and scope["type"] == "http" and scope["path"] == "/health":
            words = json.dumps({"status": "ok", "ready": False})
            await answer(send, 200, words, kind="application/json")
            return
        await self._there.wait()
        assert self._app is not None
        await self._app(scope, receive, send)
