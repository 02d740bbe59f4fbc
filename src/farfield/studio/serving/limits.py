"""How much the server takes."""

MESSAGE_BYTES = 1 << 20
"""Longest message of a WebSocket."""
BODY_BYTES = 8 << 20
"""Longest body of a request."""
WINDOWS = 8
"""Windows at a time."""
EDITS_A_SECOND = 200.0
"""Of a window, in the long run."""
EDITS_AT_ONCE = 1200
"""Of a window, in a burst."""
BAD_MESSAGES = 20
"""A window that sent so many messages that are none is closed."""
TOKEN_S = 600.0
"""How long a link may be used."""
PING_S = 20.0
CACHE_BYTES = 512 << 20
"""Of layers as they are sent."""
