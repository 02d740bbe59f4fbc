import socket
import threading
import time

from _studio_process import slow_link


def echo(listener: socket.socket) -> None:
    connection, _ = listener.accept()
    with connection:
        while data := connection.recv(65536):
            connection.sendall(data)


def test_the_link_has_its_delay_and_its_rate():
    with socket.create_server(("127.0.0.1", 0)) as listener:
        threading.Thread(target=echo, args=(listener,), daemon=True).start()
        with slow_link(listener.getsockname()[1]) as port, socket.create_connection(("127.0.0.1", port)) as line:
            started = time.monotonic()
            line.sendall(b"x")
            assert line.recv(1) == b"x"
            assert time.monotonic() - started >= 0.05
            started, body, got = time.monotonic(), b"y" * 500_000, 0
            line.sendall(body)
            while got < len(body):
                got += len(line.recv(65536))
            assert time.monotonic() - started >= len(body) / 2.5e6


def test_connections_that_are_open_at_once_share_the_rate():
    with socket.create_server(("127.0.0.1", 0)) as listener:
        for _ in range(2):
            threading.Thread(target=echo, args=(listener,), daemon=True).start()
        with slow_link(listener.getsockname()[1]) as port:
            lines = [socket.create_connection(("127.0.0.1", port)) for _ in range(2)]
            body, started = b"z" * 250_000, time.monotonic()
            for line in lines:
                line.sendall(body)
            for line in lines:
                got = 0
                while got < len(body):
                    got += len(line.recv(65536))
                line.close()
            assert time.monotonic() - started >= 2 * len(body) / 2.5e6
