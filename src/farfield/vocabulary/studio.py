"""Where the studio is found: what it listens on, and what a link into it looks like."""

from urllib.parse import quote

STUDIO_PORT = 8877
"""Tried first."""


def studio_link(sequence: str, frame_id: str) -> str:
    """Link to a frame in a studio that shows its data set.

    >>> studio_link("1", "00006_00001")
    'http://127.0.0.1:8877/?frame=1%2F00006_00001'
    """
    return f"http://127.0.0.1:{STUDIO_PORT}/?frame={quote(f'{sequence}/{frame_id}', safe='')}"
