"""A whole simulated machine: plant, drives on a CAN bus, tracker, force sensor and thermometers, wired to each other.

What comes out is a site description in plain data, which a bench opens as it opens a real one. In-process (this file)
the instruments sit on loopback ports and time is stepped by whoever waits; simulators/serve.py puts the same machine on
real endpoints in a process of its own.

Wiring (scales, senses, offsets of the encoders) is ours, and deliberately not trivial: an axis that counts backwards or
from the middle of its travel is the commonest mistake of a new site.

Known limitations: drives and plant share the machine file's limits; no collision; nobody trips over a cable.
"""

from __future__ import annotations

import itertools
import json
import os
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import serial
import yaml
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from simulators.chain import Chain
from simulators.concealed.live import CarriedEffect, conceal
from simulators.drive import SimulatedDrive, SimulatedDriveRack
from simulators.force_torque import SimulatedBota, SimulatedGsv8
from simulators.plant import LivePlant, Load, Plant
from simulators.serial_line import LoopbackPort, SerialDevice
from simulators.tracker import SimulatedTracker

Array = NDArray[np.float64]

COUNTS_PER_M, COUNTS_PER_RAD = 5.0e6, 8.0e6  # 0.2 µm and 0.125 µrad: linear scales and geared absolute encoders
STOPPING = 0.5  # deceleration of a quick stop [m/s² or rad/s²]
ANSWER_S = 1.0  # simulated instruments answer at once; this is for a loaded computer
TOGETHER_S = 0.2  # starts this near to each other are one motion
LOGGER_PERIOD_S = 60.0  # how often the thermometers' logger writes its file
AIR_PRESSURE_HPA, AIR_HUMIDITY_PCT = 1008.0, 45.0
_serial = itertools.count(1)


class Clock(Protocol):
    def now(self) -> float: ...

    def utc(self) -> datetime: ...

    def at(self, when: float, callback: Any) -> None: ...

    def every(self, period: float, callback: Any) -> None: ...


class InstrumentClock(Protocol):
    def now(self) -> float: ...


@dataclass(frozen=True)
class Wiring:
    """counts = sense · counts_per_unit · (q − offset)"""

    node: int
    counts_per_unit: float
    sense: int
    offset: float

    def joint_value(self, counts: float) -> float:
        return self.offset + self.sense * counts / self.counts_per_unit

    def counts(self, q: float) -> float:
        return self.sense * self.counts_per_unit * (q - self.offset)


@dataclass(frozen=True)
class ToConceal:
    """What simulators/concealed/live.py needs to draw an effect: see `conceal` there."""

    seed: int
    hours: float
    salt: str
    size: float = 2.0
    effect: str | None = None


class SimulatedHardware:
    """Use as a context manager.

    folder         where the thermometers' file is written
    thermometers   its name: one for each hall
    force_protocol "bota" | "gsv8"
    repeatability  [m] instead of the machine file's
    fitted         reflectors mounted; by default all there is a place for, `treatment` too
    instrument_clock  what paces the sensor's stream, where that must not be hurried machine time
    concealed      one effect more than the plant's truth, if any: `carried` holds its seal and, for later, what it is
    """

    def __init__(
        self,
        machine_file: str | Path,
        clock: Clock,
        folder: str | Path,
        *,
        seed: int = 1,
        force_protocol: str = "bota",
        repeatability: float | None = None,
        fitted: Sequence[str] | None = None,
        instrument_clock: InstrumentClock | None = None,
        concealed: ToConceal | None = None,
        thermometers: str = "temperatures.json",
    ) -> None:
        self.machine_file = Path(machine_file).resolve()
        self._thermometer_file = Path(folder).resolve() / thermometers
        self.clock = clock
        self.seed = seed
        self.force_protocol = force_protocol
        self.plant = Plant.from_file(self.machine_file, seed, repeatability)
        self.channel = f"ppshw-sim-{os.getpid()}-{next(_serial)}"
        self.wiring = _wire(self.plant.chain)
        self.rack = SimulatedDriveRack(clock, self.channel)
        for joint, wire in zip(self.plant.chain.joints, self.wiring, strict=True):
            parked = min(max(0.0, joint.lower), joint.upper)
            self.rack.add(SimulatedDrive(wire.node, clock, self.rack.network, start=wire.counts(parked)))
        everything = [*self.plant.targets, *self.plant.chain.points]
        self.carried: CarriedEffect | None = None
        if concealed is not None:
            self.carried = conceal(
                self.plant, concealed.seed, concealed.hours, concealed.salt, _Ways(self), concealed.size,
                concealed.effect,
            )  # fmt: skip
        self.live = LivePlant(
            self.plant, self.joint_values, clock, fitted=everything if fitted is None else fitted,
            carries=self.carried,
        )  # fmt: skip
        world = _Standing(self.live, self.joint_values)
        pace = instrument_clock or clock
        self.tracker = SimulatedTracker(world, pace, seed=seed, position_sigma=self.plant.position_sigma, air=self._air)
        sensor = {"bota": SimulatedBota, "gsv8": SimulatedGsv8}[force_protocol]
        self.force_sensor: SimulatedBota | SimulatedGsv8 = sensor(world, pace, seed=seed)
        self._write_temperatures()
        clock.every(LOGGER_PERIOD_S, self._write_temperatures)

    def __enter__(self) -> SimulatedHardware:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    def close(self) -> None:
        self.rack.close()

    @property
    def ports(self) -> dict[str, serial.SerialBase]:
        """New ports to the instruments, for one bench: a driver that is collected late closes its own only."""
        return {
            "loopback:tracker": LoopbackPort(self.tracker),
            "loopback:force_sensor": LoopbackPort(self.force_sensor),
        }

    def drive(self, joint: str) -> SimulatedDrive:
        return self.rack.drives[self.wiring[self.plant.joint_names.index(joint)].node]

    def device(self, name: str) -> SerialDevice:
        return {"tracker": self.tracker, "force_sensor": self.force_sensor}[name]

    def joint_values(self) -> Array:
        """(n,) where the joints truly are now."""
        motors = self.rack.motor_positions()
        return np.array([wire.joint_value(motors[wire.node]) for wire in self.wiring])

    def put_on(self, mass_kg: float, com: Sequence[float]) -> None:
        """A load on the couch; com (3,) in the end-effector frame [m], as in a campaign script. 0 kg takes it off."""
        chain = self.plant.chain
        in_sensor = np.linalg.inv(chain.sensor) @ chain.tip @ np.append(np.asarray(com, dtype=float), 1.0)
        self.live.set_load(Load(mass_kg, in_sensor[:3]) if mass_kg > 0 else None)

    # --- the site description ------------------------------------------------------------------------------
    def site(self) -> dict[str, Any]:
        """For a bench in this process, on stepped time."""
        return self.site_on(
            {"interface": "virtual", "channel": self.channel},
            {"tracker": "loopback:tracker", "force_sensor": "loopback:force_sensor"},
            # machine time costs nothing, heartbeats and looks at the axes do: few of them; answers cost real time, of
            # threads in one, and all of them were half a second late on two cores with four other computations
            {
                "poll_period": 0.5,
                "heartbeat_period": 2.0,
                "heartbeat_timeout": 6.0,
                "answer_timeout": 2.0,
                "sdo_timeout": 1.0,
            },
        )

    def site_on(self, bus: Mapping[str, Any], ports: Mapping[str, str], times: Mapping[str, float]) -> dict[str, Any]:
        tracker: dict[str, Any] = {
            "protocol": "geocom",
            "port": ports["tracker"],
            "timeout_s": ANSWER_S,
            "atmosphere": {
                "temperature_from": "air", "pressure_hPa": AIR_PRESSURE_HPA, "humidity_pct": AIR_HUMIDITY_PCT,
            },
        }  # fmt: skip
        if self.plant.chain.measuring is None:
            tracker["pose"] = _rough(self.plant.measuring_in_base)
        return {
            "name": f"simulated {self.plant.chain.name}, seed {self.seed}",
            "machine": str(self.machine_file),
            "can": {"bus": dict(bus), **times},
            "axes": {
                joint.name: {
                    "node": wire.node, "counts_per_unit": wire.counts_per_unit, "direction": wire.sense,
                    "offset": wire.offset, "window": 2e-5, "following_window": 5e-3, "product": 0x50505301,
                    "parameters": {"0x6085:0": round(STOPPING * wire.counts_per_unit)},
                }
                for joint, wire in zip(self.plant.chain.joints, self.wiring, strict=True)
            },
            "tracker": tracker,
            "force_sensor": {"protocol": self.force_protocol, "port": ports["force_sensor"], "timeout_s": ANSWER_S},
            "thermometers": [{"protocol": "file", "path": str(self._thermometer_file)}],
        }  # fmt: skip

    def write_site(self, path: str | Path, site: Mapping[str, Any] | None = None) -> Path:
        _write_at_once(Path(path), yaml.safe_dump(dict(site or self.site()), sort_keys=False))
        return Path(path)

    # --- the hall ------------------------------------------------------------------------------------------
    def _air(self) -> tuple[float, float, float]:
        return self.live.temperatures()["air"], AIR_PRESSURE_HPA, AIR_HUMIDITY_PCT

    def _write_temperatures(self) -> None:
        said = {"time": self.clock.utc().isoformat(), "temperatures_C": self.live.temperatures()}
        _write_at_once(self._thermometer_file, json.dumps(said))


def _write_at_once(path: Path, text: str) -> None:
    """Whoever reads meanwhile finds the old file or the new one, whole."""
    fresh = path.with_name(f"{path.name}.new")
    fresh.write_text(text, encoding="utf-8")
    fresh.replace(path)


class _Ways:
    """Where the axes were sent since last asked: (when they left, joint values), axes that start together as one."""

    def __init__(self, hardware: SimulatedHardware) -> None:
        self._hardware = hardware
        self._read = [0] * len(hardware.wiring)
        self._target = hardware.joint_values()

    def __call__(self) -> list[tuple[float, Array]]:
        orders: list[tuple[float, int, float]] = []
        for k, wire in enumerate(self._hardware.wiring):
            drive = self._hardware.rack.drives[wire.node]
            for start, counts in list(zip(drive.starts, drive.targets, strict=False))[self._read[k] :]:
                orders.append((start, k, wire.joint_value(counts)))
                self._read[k] += 1
        out: list[tuple[float, Array]] = []
        for start, k, value in sorted(orders):
            if not out or start - out[-1][0] > TOGETHER_S:
                out.append((start, self._target.copy()))
            out[-1][1][k] = self._target[k] = value
        return out


class _Standing:
    """The live plant as the instruments ask it: the same answer, without the work, while nothing has changed."""

    def __init__(self, live: LivePlant, joint_values: Callable[[], Array]) -> None:
        self._live, self._joint_values = live, joint_values
        self._lock = threading.Lock()
        self._state: tuple[object, ...] | None = None
        self._load: Load | None = None
        self._targets: dict[str, Array] | None = None
        self._wrench: Array | None = None

    def visible_targets(self) -> dict[str, Array]:
        with self._lock:
            self._refresh()
            if self._targets is None:
                self._targets = self._live.visible_targets()
            return dict(self._targets)

    def wrench(self) -> Array:
        with self._lock:
            self._refresh()
            if self._wrench is None:
                self._wrench = self._live.wrench()
            return self._wrench.copy()

    def _refresh(self) -> None:
        load = self._live.load
        state = (self._joint_values().tobytes(), self._live.fitted, self._live.moment())
        if state != self._state or load is not self._load:
            self._state, self._load, self._targets, self._wrench = state, load, None, None


def _wire(chain: Chain) -> list[Wiring]:
    """Every other axis counts backwards; every third counts from the middle of its travel."""
    wires = []
    for k, joint in enumerate(chain.joints):
        wires.append(
            Wiring(
                node=k + 1,
                counts_per_unit=COUNTS_PER_M if joint.prismatic else COUNTS_PER_RAD,
                sense=-1 if k % 2 else 1,
                offset=(joint.lower + joint.upper) / 2 if k % 3 == 2 else 0.0,
            )
        )
    return wires


def _rough(pose: Array) -> dict[str, list[float]]:
    """What a tape measure would give: centimetres and milliradians."""
    rpy = Rotation.from_matrix(pose[:3, :3]).as_euler("xyz")
    return {"xyz": np.round(pose[:3, 3], 2).tolist(), "rpy": np.round(rpy, 3).tolist()}
