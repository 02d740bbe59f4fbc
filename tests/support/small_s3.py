"""A server of S3's requests as far as they are needed here, on 127.0.0.1, which can be told to fail."""

import hashlib
import re
import socket
import struct
import threading
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from urllib.parse import parse_qs, unquote, urlsplit
from xml.sax.saxutils import escape, unescape

Fault = Callable[[str, str], str | None]
"""By method and path: ``"503"``, ``"404"``, ``"cut"`` in the middle of a body, ``"short"``; None for an answer."""
PAGE = 100


class SmallS3(ThreadingHTTPServer):
    """Buckets in memory: ``objects`` by bucket and key, ``uploads`` that have not ended, ``requests`` as they came."""

    daemon_threads = True

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), _Handler)
        self.objects: dict[str, bytes] = {}
        self.uploads: dict[str, dict[int, bytes]] = {}
        self.requests: list[tuple[str, str]] = []
        self.fault: Fault = lambda method, path: None
        self.lock = threading.Lock()
        threading.Thread(target=self.serve_forever, daemon=True).start()

    @property
    def environment(self) -> dict[str, str]:
        """What the variables of a client say."""
        return {
            "AWS_ACCESS_KEY_ID": "key",
            "AWS_SECRET_ACCESS_KEY": "secret",
            "AWS_REGION": "us-east-1",
            "AWS_ENDPOINT_URL": f"http://127.0.0.1:{self.server_port}",
            "AWS_ALLOW_HTTP": "true",
        }

    def handle_error(self, request: object, client_address: object) -> None:
        """Clients go away, too."""


def _tag(data: bytes) -> str:
    return f'"{hashlib.md5(data).hexdigest()}"'


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    server: SmallS3

    def log_message(self, *words: object) -> None:
        pass

    def _answer(self, status: int, body: bytes = b"", *, length: int | None = None, **headers: str) -> None:
        self.send_response(status)
        for name, value in headers.items():
            self.send_header(name.replace("_", "-"), value)
        self.send_header("Content-Length", str(len(body) if length is None else length))
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(body)

    def _cut(self) -> None:
        """End the connection as one that breaks: RST."""
        self.connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        self.connection.close()
        self.close_connection = True

    def _serve(self) -> None:
        parts = urlsplit(self.path)
        path, query = unquote(parts.path).strip("/"), parse_qs(parts.query, keep_blank_values=True)
        self.server.requests.append((self.command, path))
        fault = self.server.fault(self.command, path)
        length = int(self.headers.get("Content-Length") or 0)
        if fault == "cut" and length:
            self.rfile.read(length // 2)
            return self._cut()
        body = self.rfile.read(length)
        if fault == "503":
            return self._answer(503, b"<Error><Code>SlowDown</Code></Error>")
        if fault == "404":
            return self._answer(404, b"<Error><Code>NoSuchBucket</Code></Error>")
        with self.server.lock:
            return getattr(self, f"_{self.command.lower()}")(path, query, body, fault)

    do_GET = do_HEAD = do_PUT = do_POST = do_DELETE = _serve

    def _get(self, path: str, query: dict[str, list[str]], body: bytes, fault: str | None) -> None:
        if "list-type" in query:
            return self._list(path, query)
        data = self.server.objects.get(path)
        if data is None:
            return self._answer(404, b"<Error><Code>NoSuchKey</Code></Error>")
        tag = _tag(data)
        if self.headers.get("If-Match") not in (None, tag):
            return self._answer(412, b"<Error><Code>PreconditionFailed</Code></Error>")
        span = re.fullmatch(r"bytes=(\d+)-(\d*)", self.headers.get("Range") or "")
        stated = {"ETag": tag, "Last_Modified": "Sun, 29 Nov 2026 12:00:00 GMT"}
        status = 200
        if span:
            first, last = int(span[1]), min(int(span[2] or len(data)), len(data) - 1)
            stated["Content_Range"] = f"bytes {first}-{last}/{len(data)}"
            status, data = 206, data[first : last + 1]
        if fault in ("cut", "short") and self.command == "GET":
            self._answer(status, data[: len(data) // 2], length=len(data), **stated)
            return self._cut()
        return self._answer(status, data, **stated)

    _head = _get

    def _list(self, bucket: str, query: dict[str, list[str]]) -> None:
        prefix, delimiter = query.get("prefix", [""])[0], query.get("delimiter", [""])[0]
        start = query.get("continuation-token", [""])[0]
        objects, prefixes = [], set()
        for path in sorted(self.server.objects):
            key = path.removeprefix(f"{bucket}/")
            if not path.startswith(f"{bucket}/") or not key.startswith(prefix):
                continue
            rest = key[len(prefix) :]
            if delimiter and delimiter in rest:
                prefixes.add(prefix + rest.partition(delimiter)[0] + delimiter)
            else:
                objects.append((key, self.server.objects[path]))
        rows = [(key, self._contents(key, data)) for key, data in objects]
        rows += [(key, f"<CommonPrefixes><Prefix>{escape(key)}</Prefix></CommonPrefixes>") for key in prefixes]
        rows = sorted(row for row in rows if row[0] > start)
        page, more = rows[:PAGE], len(rows) > PAGE
        token = f"<NextContinuationToken>{escape(page[-1][0])}</NextContinuationToken>" if more else ""
        text = f"<IsTruncated>{str(more).lower()}</IsTruncated>{token}{''.join(xml for _, xml in page)}"
        self._answer(200, f"<ListBucketResult>{text}</ListBucketResult>".encode(), Content_Type="application/xml")

    def _contents(self, key: str, data: bytes) -> str:
        tag = escape(_tag(data), {'"': "&quot;"})
        inner = f"<Key>{escape(key)}</Key><Size>{len(data)}</Size><ETag>{tag}</ETag>"
        return f"<Contents>{inner}<LastModified>2026-11-29T12:00:00.000Z</LastModified></Contents>"

    def _put(self, path: str, query: dict[str, list[str]], body: bytes, fault: str | None) -> None:
        if "uploadId" in query:
            self.server.uploads[query["uploadId"][0]][int(query["partNumber"][0])] = body
        else:
            self.server.objects[path] = body
        self._answer(200, ETag=_tag(body))

    def _post(self, path: str, query: dict[str, list[str]], body: bytes, fault: str | None) -> None:
        if "delete" in query:
            keys = re.findall("<Key>([^<]*)</Key>", body.decode())
            for key in keys:
                self.server.objects.pop(f"{path}/{unescape(key)}", None)
            xml = f"<DeleteResult>{''.join(f'<Deleted><Key>{key}</Key></Deleted>' for key in keys)}</DeleteResult>"
        elif "uploads" in query:
            name = f"upload{len(self.server.requests)}"
            self.server.uploads[name] = {}
            xml = f"<InitiateMultipartUploadResult><UploadId>{name}</UploadId></InitiateMultipartUploadResult>"
        else:
            parts = self.server.uploads.pop(query["uploadId"][0])
            self.server.objects[path] = b"".join(parts[number] for number in sorted(parts))
            tag = escape(_tag(self.server.objects[path]), {'"': "&quot;"})
            xml = f"<CompleteMultipartUploadResult><ETag>{tag}</ETag></CompleteMultipartUploadResult>"
        self._answer(200, xml.encode(), Content_Type="application/xml")

    def _delete(self, path: str, query: dict[str, list[str]], body: bytes, fault: str | None) -> None:
        if "uploadId" in query:
            self.server.uploads.pop(query["uploadId"][0], None)
        else:
            self.server.objects.pop(path, None)
        self._answer(204)
