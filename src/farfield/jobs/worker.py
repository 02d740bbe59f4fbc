"""A worker process: ``python -m farfield.jobs.worker``, spoken to through its pipes."""

import os
import pickle
import signal
import traceback
from contextlib import suppress
from io import FileIO
from queue import SimpleQueue
from threading import Thread, Timer
from types import FrameType
from typing import IO, TYPE_CHECKING, Any, NoReturn

if TYPE_CHECKING:
    from farfield.jobs.units import JobWork

_LEAVE_S = 5.0


class _Inbox(Thread):
    """Reads what the command sends, and ends the worker with it: nobody else would."""

    def __init__(self, pipe: FileIO) -> None:
        super().__init__(daemon=True)
        self.pipe, self.messages, self.busy = pipe, SimpleQueue[bytes | None](), False

    def run(self) -> None:
        """Read until the command closes the pipe, or is no more."""
        while True:
            try:
                message = receive_packed(self.pipe)
            except (EOFError, OSError):
                break
            self.busy = True
            self.messages.put(message)
        self.messages.put(None)
        if self.busy:
            leave = Timer(_LEAVE_S, os._exit, [1])
            leave.daemon = True
            leave.start()
            os.kill(os.getpid(), signal.SIGTERM)  # the unit's own clean-up runs


def _leave(number: int, frame: FrameType | None) -> NoReturn:
    del frame
    raise SystemExit(128 + number)


def main() -> None:
    """Do one unit after the other until the command closes the pipe."""
    signal.signal(signal.SIGTERM, _leave)
    outbox = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what a library prints must not stand among the messages
    inbox = _Inbox(FileIO(0, closefd=False))  # the lock of sys.stdin's buffer would be held when the process ends
    inbox.start()
    try:
        with suppress(OSError):  # the command is no more
            _serve(inbox, outbox)
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_IGN)  # it ends by itself now


def _serve(inbox: _Inbox, outbox: IO[bytes]) -> None:
    packed = inbox.messages.get()
    if packed is None:
        return
    try:
        work = pickle.loads(packed)
    except Exception as error:  # noqa: BLE001 - the command raises it
        send(outbox, ("failed", travelling(error)))
        return
    inbox.busy = False
    send(outbox, ("ready", None))
    while (packed := inbox.messages.get()) is not None:
        answer = answered(work, packed)
        inbox.busy = False
        send(outbox, answer)


def answered(work: "JobWork", packed: bytes) -> tuple[str, Any]:
    """What a packed unit gave, or how it failed, as it is sent back to the command."""
    try:
        return "done", work(pickle.loads(packed))
    except Exception as error:  # noqa: BLE001 - the command raises it
        return "failed", travelling(error)


def travelling(error: Exception) -> tuple[bytes, str]:
    """An exception, packed, and its words, which stand alone where it does not pickle."""
    text = "".join(traceback.format_exception_only(error)).strip()
    try:
        packed = pickle.dumps(error)
        pickle.loads(packed)
    except Exception:  # noqa: BLE001 - whatever an exception's own pickling does
        return b"", text
    return packed, text


# Messages between a command and its own workers: pickles with their length before them, through pipes.

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


if __name__ == "__main__":
    main()
