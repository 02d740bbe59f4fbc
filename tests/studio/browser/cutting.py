"""A line to the studio that can be cut and joined again, at a port that stays the same."""

import contextlib
import socket
import threading


class Line:
    """Passes connections on to a port of this machine until it is cut.

    Args:
        port: Where the studio listens.
    """

    def __init__(self, port: int) -> None:
        self.there, self.cut_off = port, False
        self.ends: list[socket.socket] = []
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.port = self.listener.getsockname()[1]
        threading.Thread(target=self._accept, name="line", daemon=True).start()

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                here, _ = self.listener.accept()
                if self.cut_off:
                    here.close()
                    continue
                there = socket.create_connection(("127.0.0.1", self.there))
                self.ends += [here, there]
                for pair in ((here, there), (there, here)):
                    threading.Thread(target=_carry, args=pair, daemon=True).start()

    def cut(self) -> None:
        """Break what is open and take nothing new."""
        self.cut_off = True
        for end in self.ends:
            with contextlib.suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)
            end.close()
        self.ends.clear()

    def join(self) -> None:
        """Let connections through again."""
        self.cut_off = False

    def close(self) -> None:
        """Stop for good."""
        self.cut()
        self.listener.close()


def _carry(source: socket.socket, sink: socket.socket) -> None:
    with contextlib.suppress(OSError):
        while piece := source.recv(65536):
            sink.sendall(piece)
    for end in (source, sink):
        with contextlib.suppress(OSError):
            end.shutdown(socket.SHUT_RDWR)
        end.close()
