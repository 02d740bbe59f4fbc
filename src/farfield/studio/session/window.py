"""One window of the page, as the desk sees it."""

import asyncio
from dataclasses import dataclass, field

from farfield.studio.messages.replies import Bye, Reply


@dataclass(eq=False)
class ClientWindow:
    """A window.

    Args:
        id: Its name, its own among those open.
        annotator: Who sits before it.
        matching: Changes with every request for matches, so that an older one is given up.
        room: How many replies may wait; a window that does not read loses its place.
    """

    id: str
    annotator: str
    room: int = 5000
    frame: int | None = None
    drive: str | None = None
    threshold: float = 0.0
    sweeps: int = 1
    matching: object = None
    replies: "asyncio.Queue[Reply | str]" = field(default_factory=asyncio.Queue)

    def send(self, reply: "Reply | str") -> None:
        """Queue a reply, or its text if that is the same for many."""
        if self.replies.qsize() > self.room:
            while not self.replies.empty():
                self.replies.get_nowait()
            self.replies.put_nowait(Bye(reason="this window did not read what it was sent: reload it"))
        else:
            self.replies.put_nowait(reply)
