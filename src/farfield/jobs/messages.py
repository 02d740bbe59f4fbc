"""Messages between a command and its own workers: pickles with their length before them, through pipes."""

import pickle
from io import FileIO
from typing import IO, Any

_LENGTH = 8


def send(pipe: IO[bytes] | FileIO | None, message: Any, *, packed: bool = False) -> None:
    """Send a message, or one that is packed already.

    Raises:
        OSError: If nobody reads.
    """
    if pipe is None:
        raise OSError("no pipe")
    data = message if packed else pickle.dumps(message, pickle.HIGHEST_PROTOCOL)
    pipe.write(len(data).to_bytes(_LENGTH, "little"))
    pipe.write(data)
    pipe.flush()


def receive(pipe: IO[bytes] | FileIO | None) -> Any:
    """Wait for a message and unpack it.

    Raises:
        EOFError: If the other end is closed.
    """
    return pickle.loads(receive_packed(pipe))


def receive_packed(pipe: IO[bytes] | FileIO | None) -> bytes:
    """Wait for a message; it stays packed.

    Raises:
        EOFError: If the other end is closed.
    """
    if pipe is None:
        raise EOFError
    return _bytes(pipe, int.from_bytes(_bytes(pipe, _LENGTH), "little"))


def _bytes(pipe: IO[bytes] | FileIO, count: int) -> bytes:
    """So many bytes, of a pipe that may give them in pieces."""
    data = bytearray()
    while len(data) < count:
        piece = pipe.read(count - len(data))
        if not piece:
            raise EOFError
        data += piece
    return bytes(data)
