"""Numbers of bytes in words, once for every message that tells how much is needed, free or written."""

from farfield.vocabulary.counts import count_of

_UNITS = ((1e12, "TB"), (1e9, "GB"), (1e6, "MB"), (1e3, "kB"))


def sized(count: float | int) -> str:
    """Bytes in the largest unit of which there is at least a tenth: no number of bytes but zero reads as nothing.

    >>> sized(0), sized(999_400), sized(250e6), sized(3.2e9), sized(12)
    ('0 bytes', '1.00 MB', '0.25 GB', '3.20 GB', '12 bytes')
    """
    for unit_bytes, unit in _UNITS:
        if count >= 0.1 * unit_bytes:
            return f"{count / unit_bytes:.2f} {unit}"
    return count_of(round(count), "byte")


def room(needed: float | int, free: float | int) -> str:
    """What is needed and what is free, such that the two never read alike: ``"1.20 GB are needed, 3.0 MB are free"``.

    >>> room(1_000_400, 1_000_000)
    '1,000,400 bytes are needed, 1,000,000 bytes are free'
    """
    texts = sized(needed), sized(free)
    if texts[0] == texts[1]:
        texts = f"{needed:,.0f} bytes", f"{free:,.0f} bytes"
    return f"{texts[0]} are needed, {texts[1]} are free"
