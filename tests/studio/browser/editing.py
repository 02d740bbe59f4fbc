"""What tests of edits share: the boxes that are stored, a click on an object, a slow link, an edit that is refused."""

from typing import Any

from _studio_screen import Screen
from studio.live import Live

FRAMES = 6


def stored(live: Live) -> list[dict[int, dict[str, Any]]]:
    """The boxes of each frame by their tracks as a new window gets them; none where a frame cannot be read."""
    with live.window() as client:
        frames = [client.open(frame) for frame in range(FRAMES)]
    return [{row["track"]: row for row in frame.get("boxes", ())} for frame in frames]


def choose(page: Screen, track: int) -> dict[str, Any]:
    """Look at an object from above and click it."""
    row = next(row for row in page.boxes if row["track"] == track)
    page.look(*row["box"][:2], 25)
    page.click(row["box"][:3])
    page.settled()
    assert page.selected is not None
    assert page.selected["track"] == track
    return row


def slow(page: Screen, latency_ms: float) -> None:
    page.page.evaluate(f"Object.assign(roughLink, {{ least: {latency_ms}, most: {latency_ms} }})")


def damage_next(page: Screen, op: str) -> None:
    """Make the next edit of a kind one that is refused."""
    page.page.evaluate(
        """(op) => {
          const Socket = WebSocket.prototype.send;
          let damaged = 0;
          WebSocket.prototype.send = function (text) {
            const message = JSON.parse(text);
            if (message.op === op && damaged === 0) damaged = message.id;
            if (message.id === damaged && damaged !== 0) message.value.box[3] = 600;
            Socket.call(this, JSON.stringify(message));
          };
        }""",
        op,
    )
