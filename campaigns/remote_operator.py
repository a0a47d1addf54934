"""The simulated operator at the far end of a line: one line of JSON per request, one line of answer.

    {"put_on": {"name": "head", "mass_kg": 150, "com": [0, 0.15, 0.8]}}\n   →   {"ok": true}\n

com is in the end-effector frame [m], as in a campaign script. Only simulated hardware has such a line.
"""

from __future__ import annotations

import json

import serial

from campaigns.script import LoadCase
from ppshw.errors import HardwareError, HardwareTimeout, ProtocolError

DEVICE = "simulated operator"
TIMEOUT_S = 5.0


def put_on_by_line(url: str, load: LoadCase) -> None:
    request = {"put_on": {"name": load.name, "mass_kg": load.mass, "com": list(load.com)}}
    try:
        with serial.serial_for_url(url, timeout=TIMEOUT_S) as line:
            line.write(json.dumps(request).encode() + b"\n")
            answer = line.readline()
    except (serial.SerialException, OSError) as error:
        raise HardwareError(DEVICE, f"cannot be reached on {url}: {error}") from error
    if not answer:
        raise HardwareTimeout(DEVICE, f"no answer on {url} within {TIMEOUT_S:g} s")
    try:
        said = json.loads(answer)
    except ValueError:
        said = {}
    if said.get("ok") is not True:
        raise ProtocolError(DEVICE, f"answers {answer.decode(errors='replace').strip()!r} to a load change")
