"""Arrays of many numbers in a JSON file: exact, and a tenth of what their digits would take."""

from __future__ import annotations

import base64
import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
ENCODING = "float64 little-endian, zlib, base64"


def packed(values: Array) -> dict[str, Any]:
    """An array of any shape, rows first."""
    data = base64.b64encode(zlib.compress(values.astype("<f8").tobytes(), 1)).decode()
    return {"shape": list(values.shape), "encoding": ENCODING, "data": data}


def unpacked(data: dict[str, Any]) -> Array:
    """Raises ValueError, zlib.error or KeyError where it is not what `packed` gave."""
    numbers = np.frombuffer(zlib.decompress(base64.b64decode(data["data"])), dtype="<f8")
    return numbers.reshape([int(n) for n in data["shape"]]).astype(float)
