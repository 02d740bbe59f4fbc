"""The LZF compression of PCD's binary_compressed body, in plain Python.

A stream is a sequence of tokens. Control byte c < 32: c + 1 literal bytes follow. Otherwise a copy from the output:
length (c >> 5) + 2, where 7 << 5 means that one more byte is added to the length; then the low byte of the distance
minus one, whose upper five bits are in c. So a copy is 3..264 bytes from at most 8192 bytes back.
"""

import numpy as np
from jaxtyping import Int, UInt8

MAX_EXPANSION = 88  # three bytes stand for at most 264
_MAX_LITERAL, _MAX_COPY, _MAX_DISTANCE = 32, 264, 8192


class LzfError(ValueError):
    """The stream is damaged; the argument is a message that names the byte within the stream."""


def decompress(stream: bytes, size: int) -> bytes:
    """Expand a stream.

    Args:
        stream: The compressed bytes.
        size: Number of bytes that must come out; not allocated before they do.

    Raises:
        LzfError: If the stream ends within a token, refers before the beginning, or gives another number of bytes.
    """
    output, position, end = bytearray(), 0, len(stream)
    try:
        while position < end:
            control = stream[position]
            if control < _MAX_LITERAL:
                following = position + control + 2
                output += stream[position + 1 : following]
                position = following
                continue
            length = (control >> 5) + 2
            if length == 9:
                position += 1
                length += stream[position]
            distance = ((control & 31) << 8) + stream[position + 1] + 1
            position += 2
            start = len(output) - distance
            if start < 0:
                raise LzfError(f"byte {position - 2}: a copy from {-start} bytes before the beginning")
            if distance >= length:
                output += output[start : start + length]
            else:
                output += (output[start:] * (length // distance + 1))[:length]
            if len(output) > size:
                break
    except IndexError:
        raise LzfError(f"byte {position}: the stream ends within a token") from None
    if position > end or len(output) != size:
        raise LzfError(f"byte {min(position, end)}: {len(output)} bytes came out instead of {size}")
    return bytes(output)


def compress(data: bytes) -> bytes:
    """Compress bytes; data without repetitions grow by one byte in 32."""
    following, length, distance = _copies(np.frombuffer(data, dtype=np.uint8))
    output, position, size = bytearray(), 0, len(data)
    while position < size:
        target = following[position] if position < len(following) else size
        while position < target:
            run = min(target - position, _MAX_LITERAL)
            output.append(run - 1)
            output += data[position : position + run]
            position += run
        if position < size:
            copied, back = min(length[position], _MAX_COPY), distance[position] - 1
            if copied < 9:
                output.append((copied - 2) << 5 | back >> 8)
            else:
                output += bytes((7 << 5 | back >> 8, copied - 9))
            output.append(back & 255)
            position += copied
    return bytes(output)


def _copies(data: UInt8[np.ndarray, " n"]) -> tuple[list[int], list[int], list[int]]:
    """For each position: the next one at which a copy may begin, and that copy's length and distance.

    A copy may begin where the same three bytes stood at most 8192 bytes before. Neighbouring positions with the same
    distance make one longer copy.
    """
    count = max(len(data) - 2, 0)
    if count == 0:
        return [], [], []
    triple = data[:-2].astype(np.uint32) << 16 | data[1:-1].astype(np.uint32) << 8 | data[2:]
    order = np.argsort(triple, kind="stable")
    repeated = triple[order[1:]] == triple[order[:-1]]
    distance: Int[np.ndarray, " n"] = np.zeros(count, dtype=np.int64)
    distance[order[1:][repeated]] = (order[1:] - order[:-1])[repeated]
    distance[distance > _MAX_DISTANCE] = 0
    index = np.arange(count)
    changes = np.append(distance[1:] != distance[:-1], True)
    run_end = np.minimum.accumulate(np.where(changes, index, count)[::-1])[::-1]
    begin = np.minimum.accumulate(np.where(distance > 0, index, len(data))[::-1])[::-1]
    return begin.tolist(), (run_end - index + 3).tolist(), distance.tolist()
