"""The simulated machine as a process of its own, on endpoints that a driver opens like real ones.

    drives         slcan on a TCP port, as a USB-CAN adapter behind ser2net would be
    tracker        GeoCOM on a TCP port
    force sensor   its stream on a TCP port
    operator       a line of JSON on a TCP port: {"put_on": {"mass_kg": …, "com": […]}}
    thermometers   a file that is replaced every minute of machine time

Machine time runs `speed` times as fast as real time; the site file that is written says so, and says times in machine
seconds that are real ones on the wire: a heartbeat every half second of real time is one every 25 s at speed 50.

Known limitations: above a speed of some 50 the margins of the drivers (seconds of machine time) become milliseconds of
real time, and a busy computer looks like a slow machine. Instruments keep real time.
"""

from __future__ import annotations

import contextlib
import json
import signal
import socketserver
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import yaml

from simulators.can_gateway import SlcanGateway
from simulators.hardware import SimulatedHardware
from simulators.scaled_clock import ScaledClock
from simulators.serial_line import TcpLine

LONGEST_HEARTBEAT_S = 60.0  # object 0x1017 holds 65 535 ms


class RealTime:
    """What the instruments go by."""

    def now(self) -> float:
        return time.monotonic()


def serve(
    machine_file: str | Path,
    site_out: str | Path,
    *,
    seed: int = 1,
    speed: float = 1.0,
    force_protocol: str = "bota",
    ready: Callable[[Path], None] | None = None,
    stop: threading.Event | None = None,
) -> None:
    """Write the site file, then serve until Ctrl-C, SIGTERM or `stop`.

    ready   called with the site file's path when everything listens; by default a line is printed
    """
    stop = stop or threading.Event()
    with contextlib.suppress(ValueError):  # only the main thread may set this
        signal.signal(signal.SIGTERM, lambda *_: stop.set())
    site_out = Path(site_out).resolve()
    with serving(machine_file, site_out, seed=seed, speed=speed, force_protocol=force_protocol):
        (ready or _announce)(site_out)
        with contextlib.suppress(KeyboardInterrupt):
            stop.wait()


@contextlib.contextmanager
def serving(
    machine_file: str | Path,
    site_out: Path,
    *,
    seed: int = 1,
    speed: float = 1.0,
    force_protocol: str = "bota",
) -> Iterator[SimulatedHardware]:
    """Everything listens inside the context, and the site file is there."""
    with contextlib.ExitStack() as stack:
        clock = ScaledClock(speed, _epoch_before(site_out, speed))
        stack.callback(clock.close)
        hardware = stack.enter_context(
            SimulatedHardware(
                machine_file, clock, site_out.parent, seed=seed, force_protocol=force_protocol,
                instrument_clock=RealTime(), thermometers=f"{site_out.stem}.temperatures.json",
            )
        )  # fmt: skip
        gateway = stack.enter_context(SlcanGateway(hardware.channel))
        tracker, sensor = TcpLine(hardware.tracker), TcpLine(hardware.force_sensor)
        stack.callback(tracker.close)
        stack.callback(sensor.close)
        operator = stack.enter_context(_OperatorLine(hardware))
        bus = {"interface": "slcan", "channel": gateway.url, "bitrate": 500_000, "sleep_after_open": 0}
        site = hardware.site_on(bus, {"tracker": tracker.url, "force_sensor": sensor.url}, times_at(speed))
        site["thermometers"][0]["max_age_s"] = 300.0 + 10.0 * speed
        site["operator"] = {"kind": "simulated", "port": operator.url}
        site["clock"] = {"speed": speed, "epoch": clock.epoch}
        hardware.write_site(site_out, site)
        yield hardware


def times_at(speed: float) -> dict[str, float]:
    """Bus times in machine seconds that are sane in real ones: SYNC 10 ms, heartbeat 0.5 s, its loss after 2 s."""
    heartbeat = min(0.5 * max(speed, 1.0), LONGEST_HEARTBEAT_S)
    return {
        "sync_period": 0.01 * speed if speed > 1 else 0.01,
        "poll_period": max(0.1, 0.02 * speed),
        "heartbeat_period": heartbeat,
        "heartbeat_timeout": max(4 * heartbeat, 2.0 * speed),
        "answer_timeout": 1.0 * max(speed, 1.0),
        "sdo_timeout": 1.0,
    }


def is_ours(site: Path) -> bool:
    """Whether a file is a site file that `serve` wrote, which it may write anew; any other is somebody's own."""
    return bool(_clock_of(site))


def _epoch_before(site_out: Path, speed: float) -> float | None:
    """Started again on the same site file, the hall's clock runs on: hurried time must not jump back."""
    clock = _clock_of(site_out)
    return float(clock["epoch"]) if clock.get("speed") == speed else None


def _clock_of(site: Path) -> dict[str, float]:
    """What a site file that `serve` wrote says of its clock; empty where there is none."""
    try:
        said = yaml.safe_load(site.read_text(encoding="utf-8"))
        clock = said["clock"] if said["operator"]["kind"] == "simulated" else {}
        return {key: float(clock[key]) for key in ("speed", "epoch")}
    except (OSError, ValueError, LookupError, TypeError, yaml.YAMLError):
        return {}


def _announce(site: Path) -> None:
    print(f"simulated hardware is ready; site file {site}; stop it with Ctrl-C", flush=True)


class _OperatorLine:
    """Puts loads on when asked to, one JSON line per request."""

    def __init__(self, hardware: SimulatedHardware) -> None:
        class Handler(socketserver.StreamRequestHandler):
            def handle(self) -> None:
                for line in self.rfile:
                    self.wfile.write(json.dumps(_obey(hardware, line)).encode() + b"\n")

        self._server = socketserver.ThreadingTCPServer(("127.0.0.1", 0), Handler)
        self._server.daemon_threads = True
        host, port = self._server.server_address[:2]
        self.url = f"socket://{host!s}:{port}"
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.05,), daemon=True)
        self._thread.start()

    def __enter__(self) -> _OperatorLine:
        return self

    def __exit__(self, *exc: object) -> None:
        self._server.shutdown()
        self._server.server_close()
        self._thread.join(timeout=5)


def _obey(hardware: SimulatedHardware, line: bytes) -> dict[str, Any]:
    try:
        wanted = json.loads(line)["put_on"]
        hardware.put_on(float(wanted["mass_kg"]), [float(x) for x in wanted["com"]])
    except (ValueError, KeyError, TypeError) as problem:
        return {"ok": False, "why": f"not understood: {problem}"}
    return {"ok": True}
