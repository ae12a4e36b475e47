"""Messages between two processes: NumPy archives, each behind its length in 8 bytes."""

import io

import numpy as np


def send(stream, **arrays):
    """Writes a message."""
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    stream.write(len(buffer.getbuffer()).to_bytes(8, "little"))
    stream.write(buffer.getbuffer())
    stream.flush()


def receive(stream):
    """Reads a message; none where the other side has ended."""
    size = stream.read(8)
    if len(size) < 8:
        return None
    return dict(np.load(io.BytesIO(stream.read(int.from_bytes(size, "little")))))
