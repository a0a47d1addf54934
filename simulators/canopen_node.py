"""A CANopen slave on simulated time: canopen's LocalNode (SDO server) plus what that lacks.

Added here, from CiA 301: PDOs with mapping and transmission types, SYNC, heartbeat on a handed-in clock,
boot-up, reset.

Known limitations: PDO COB-IDs stay in the predefined connection set; transmission types are "every SYNC"
(0–240 are taken as 1) or "on event" (254, 255); no inhibit time, event timer, RTR, block transfer or LSS; a
heartbeat is missed only where `miss_heartbeats` asks for it; a reset forgets all parameters that were written
(nothing is stored).
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import canopen

OPERATIONAL, PRE_OPERATIONAL = "OPERATIONAL", "PRE-OPERATIONAL"
PDO_INVALID = 1 << 31


class SimClock(Protocol):
    def now(self) -> float: ...

    def at(self, when: float, callback: Callable[[], None]) -> None: ...


@dataclass(frozen=True)
class _Pdo:
    cob_id: int
    synchronous: bool
    entries: tuple[tuple[int, int, int], ...]  # index, sub-index, bytes


class CanopenNode:
    """Subclasses override `read`, `written` and `tick`; all three run under `lock`."""

    def __init__(
        self, node_id: int, clock: SimClock, network: canopen.Network, eds: Path, missing: Collection[int] = ()
    ) -> None:
        self.id = node_id
        self.clock = clock
        self.lock = threading.RLock()
        self.lies: dict[tuple[int, int], int] = {}
        self.online = False
        self.late = 0  # so many SYNCs it will be too busy to answer
        self._network = network
        self._beat_series = 0
        self._pdos: dict[bool, list[_Pdo]] | None = None  # transmit? → enabled PDOs; None: mapping was written
        self._waiting: dict[int, bytes] = {}  # synchronous RPDOs that take effect at the next SYNC
        dictionary = canopen.import_od(str(eds), node_id)
        for index in missing:
            del dictionary[index]
        self.node = canopen.LocalNode(node_id, dictionary)
        self.node.add_read_callback(self._on_read)  # type: ignore[no-untyped-call]
        self.node.add_write_callback(self._on_write)  # type: ignore[no-untyped-call]
        # LocalNode would beat in real time, from a thread of its own
        self.node.nmt.start_heartbeat = self._start_heartbeat  # type: ignore[method-assign]
        network.subscribe(0x000, self._on_nmt)
        network.subscribe(0x080, self._on_sync)
        for base in (0x200, 0x300, 0x400, 0x500):
            network.subscribe(base + node_id, self._on_rpdo)

    def read(self, index: int, subindex: int) -> int | str | None:
        """The live value of an object, or None for "whatever was written last"."""
        return None

    def written(self, index: int, subindex: int, data: bytes) -> None:
        """Called before the value is stored."""

    def tick(self) -> None:
        """Called whenever time may have passed: at SYNC, heartbeat and SDO access."""

    # objects

    def value(self, index: int, subindex: int = 0, default: int = 0) -> int:
        if index not in self.node.object_dictionary:
            return default
        variable = self.node.object_dictionary.get_variable(index, subindex)
        assert variable is not None
        return int(variable.decode_raw(self.node.get_data(index, subindex)))

    def store(self, index: int, subindex: int, value: int | str) -> None:
        variable = self.node.object_dictionary.get_variable(index, subindex)
        if variable is not None:
            self.node.data_store.setdefault(index, {})[subindex] = variable.encode_raw(value)

    def _on_read(self, index: int, subindex: int, **_: Any) -> int | str | None:
        if (index, subindex) in self.lies:
            return self.lies[index, subindex]
        with self.lock:
            return self.read(index, subindex)

    def _on_write(self, index: int, subindex: int, data: bytes, **_: Any) -> None:
        with self.lock:
            if 0x1400 <= index < 0x1C00:
                self._pdos = None
            self.tick()
            self.written(index, subindex, bytes(data))

    # power and bus

    def boot(self) -> None:
        """Power-up or NMT reset: boot-up message, then PRE-OPERATIONAL."""
        with self.lock:
            self._beat_series += 1
            self._pdos = None
            self._waiting.clear()
            self.node.data_store.clear()
        self.join_bus()
        self.node.nmt.state = "INITIALISING"  # sends the boot-up message
        self.node.nmt.state = PRE_OPERATIONAL

    def join_bus(self) -> None:
        if not self.node.has_network():
            self._network.add_node(self.node)
        self.online = True

    def leave_bus(self) -> None:
        """No SDO, PDO, EMCY or heartbeat from now on."""
        self.online = False
        self.node.remove_network()

    @property
    def operational(self) -> bool:
        return self.online and self.node.nmt.state == OPERATIONAL

    def _on_nmt(self, can_id: int, data: bytearray, timestamp: float) -> None:
        command, addressee = data[0], data[1]
        if command in (129, 130) and addressee in (0, self.id) and self.online:
            self.boot()

    def emergency(self, code: int, register: int) -> None:
        """A node without object 0x1014 sends none (CiA 301: optional)."""
        if self.online and 0x1014 in self.node.object_dictionary:
            self.node.emcy.send(code, register)

    def miss_heartbeats(self) -> None:
        """Watch the heartbeat that 0x1016:1 names, from when it is first heard; once it lapses the node reports 0x8130
        and falls back to PRE-OPERATIONAL, as 0x1029:1 = 0 has it. In real time, in which a host sends it."""
        watch = self.value(0x1016, 1)
        limit, lapse = (watch & 0xFFFF) / 1000.0, threading.Timer(0.0, lambda: None)

        def heard(can_id: int, data: bytearray, timestamp: float) -> None:
            nonlocal lapse
            lapse.cancel()
            lapse = threading.Timer(limit, self._missed)
            lapse.daemon = True
            lapse.start()

        self._network.subscribe(0x700 + (watch >> 16 & 0x7F), heard)

    def _missed(self) -> None:
        if self.value(0x1016, 1):
            self.heartbeat_missed()
            self.node.nmt.state = PRE_OPERATIONAL

    def heartbeat_missed(self) -> None:
        """What the device does beside falling back."""

    def end_heartbeat(self) -> None:
        """All but its heartbeat goes on, as when another program writes 0 to 0x1017."""
        self._start_heartbeat(0)

    # heartbeat: no lock here, the clock calls with its own lock held

    def _start_heartbeat(self, heartbeat_time_ms: int) -> None:
        self._beat_series += 1
        if heartbeat_time_ms > 0:
            self._schedule_beat(self._beat_series, heartbeat_time_ms / 1000.0, self.clock.now())

    def _schedule_beat(self, series: int, period: float, last: float) -> None:
        def beat() -> None:
            if series != self._beat_series:
                return
            with self.lock:
                self.tick()
            if self.online:
                state = {OPERATIONAL: 5, PRE_OPERATIONAL: 127}.get(self.node.nmt.state, 4)
                self._network.send_message(0x700 + self.id, bytes([state]))
            self._schedule_beat(series, period, last + period)

        self.clock.at(last + period, beat)

    # PDO

    def _maps(self, transmit: bool) -> list[_Pdo]:
        if self._pdos is None:
            self._pdos = {False: self._compile(0x1400), True: self._compile(0x1800)}
        return self._pdos[transmit]

    def _compile(self, base: int) -> list[_Pdo]:
        pdos = []
        for index in range(base, base + 8):
            if index not in self.node.object_dictionary:
                continue
            cob_id = self.value(index, 1)
            if cob_id & PDO_INVALID:
                continue
            mapping = index + 0x200
            entries = [self.value(mapping, k) for k in range(1, self.value(mapping, 0) + 1)]
            layout = tuple((e >> 16, (e >> 8) & 0xFF, (e & 0xFF) // 8) for e in entries)
            pdos.append(_Pdo(cob_id & 0x7FF, self.value(index, 2) <= 240, layout))
        return pdos

    def _on_sync(self, can_id: int, data: bytearray, timestamp: float) -> None:
        """Inputs are sampled and sent first, then what came since the last SYNC takes effect (CiA 301 §7.2.2.2)."""
        if not self.operational:
            return
        with self.lock:
            if self.late:
                self.late -= 1
                return
            self.tick()
            self._transmit(synchronous=True)
            for cob_id in list(self._waiting):
                self._apply(cob_id, self._waiting.pop(cob_id))

    def send_events(self) -> None:
        """TPDOs of the event-driven types; a subclass calls this when its status changes."""
        if self.operational:
            self._transmit(synchronous=False)

    def _transmit(self, synchronous: bool) -> None:
        for pdo in self._maps(transmit=True):
            if pdo.synchronous == synchronous:
                payload = b"".join(self.node.get_data(i, s)[:n] for i, s, n in pdo.entries)
                self._network.send_message(pdo.cob_id, payload)

    def _on_rpdo(self, can_id: int, data: bytearray, timestamp: float) -> None:
        if not self.operational:
            return
        with self.lock:
            pdo = next((p for p in self._maps(transmit=False) if p.cob_id == can_id), None)
            if pdo is None:
                return
            if pdo.synchronous:
                self._waiting[can_id] = bytes(data)
            else:
                self._apply(can_id, bytes(data))

    def _apply(self, cob_id: int, data: bytes) -> None:
        """Objects are written in the order they are mapped in: a controlword mapped first would see the old target."""
        at = 0
        for pdo in self._maps(transmit=False):
            if pdo.cob_id == cob_id:
                for index, subindex, size in pdo.entries:
                    self.node.set_data(index, subindex, data[at : at + size])
                    at += size
