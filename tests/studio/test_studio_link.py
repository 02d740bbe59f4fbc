import socket
import threading
import time

from studio.link import slow_link


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
