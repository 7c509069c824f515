"""Damage to files: bytes flipped, put in and cut off, keys and values in each other's places."""

import random
import re

ODD = [
    b"nan",
    b"-inf",
    b"1e308",
    b"-1e-320",
    b"9" * 400,
    b"0x1F",
    b"010",
    b"1:30:15",
    b"",
    b"[]",
    b"{}",
    b"null",
    b"-1",
]
"""What stands in a value's place."""
TOKEN = re.compile(rb"[\w.+-]+")
"""Keys and values, whatever the format."""


def damaged(content: bytes, seed: int) -> bytes:
    """Return a content with bytes flipped, put in or cut off, or keys and values in each other's places."""
    draw, data = random.Random(seed), bytearray(content)
    for _ in range(draw.randint(1, 3)):
        at = draw.randrange(len(data) + 1)
        kind = draw.randrange(6)
        if kind == 0 and at < len(data):
            data[at] ^= 1 << draw.randrange(8)
        elif kind == 1:
            data[at:at] = draw.choice(
                [draw.randbytes(draw.randint(1, 8)), data[at : at + 20], b"\n", b",", b" ", b"["]
            )
        elif kind == 2:
            del data[at : at + draw.choice([1, 2, 10, len(data)])]
        elif tokens := [match.span() for match in TOKEN.finditer(data)]:
            (start, end), (first, last) = draw.choice(tokens), draw.choice(tokens)
            data[start:end] = bytes(data[first:last]) if kind == 3 else draw.choice(ODD)
    return bytes(data)
