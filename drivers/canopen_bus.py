"""One CAN bus: the adapter, SYNC, waiting for process data, and SDO access that says who refused what.

Built on canopen's Network and RemoteNode. SDO clients are not thread-safe, so each node has one lock; callbacks run in
the receiving thread, so they never read by SDO and never raise. A lost adapter shows only in `Network.check()`.
"""

from __future__ import annotations

import logging
import re
import struct
import threading
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import can
import canopen
from canopen.sdo.exceptions import SdoAbortedError, SdoCommunicationError

from drivers.bus_lock import BusLock
from drivers.ports import Clock
from ppshw.errors import BusLost, ConfigurationMismatch, HardwareTimeout, ProtocolError, SiteError

log = logging.getLogger(__name__)

# SDO aborts by which drives say that they have no such object: none, no sub-index, not available, no data
NO_SUCH_OBJECT = (0x06020000, 0x06090011, 0x060A0023, 0x08000024)

NO_ANSWER = "No SDO response received"  # as canopen says it, which has one class for every failure

# s of real time that an adapter may take for one message: one that takes none any more, with its own buffer and the
# system's full, is lost, and no stop of the axes hangs on it
SEND_S = 0.25

HEARTBEATS_MISSED = 3  # in a row; the drives, which wait for five periods, are then still told to stop


@dataclass(frozen=True)
class BusConfig:
    """The bus of a group of axes.

    can                python-can's own arguments: interface, channel, bitrate, sleep_after_open, …
    sync_period        SYNC while shaking hands; 10–20 ms is sane at 500 kbit/s                      [s]
    poll_period        longest time between two SYNCs while axes travel; faults reported by EMCY are acted on at
                       once all the same. Longer where simulated time makes polls the main cost               [s]
    heartbeat_period   what the drives are told to send; `heartbeat_timeout` without one is HeartbeatLost     [s]
    answer_timeout     a node that sends no process data this long after SYNC is silent                       [s]
    host_node_id       when given, the host sends a heartbeat as this node and the drives are told to watch it, so that
                       they stop by themselves when this program dies. Sent in real time: not for simulated time.
    """

    can: Mapping[str, Any]
    sync_period: float = 0.02
    poll_period: float = 0.1
    heartbeat_period: float = 0.5
    heartbeat_timeout: float = 1.5
    answer_timeout: float = 0.5
    sdo_timeout: float = 0.3
    host_node_id: int | None = None
    host_heartbeat_period: float = 0.2

    @property
    def name(self) -> str:
        return f"CAN {self.can.get('interface', '?')} {self.can.get('channel', '?')}"


class CanBus:
    """`arrival` is notified when process data, a heartbeat or an emergency came in.

    `stopped` bars every motion command from the moment of a quick stop until the group is started again; it is read
    and set under `commanding`, so that no command slips out after the stop.
    """

    def __init__(self, config: BusConfig, clock: Clock) -> None:
        self.config = config
        self.clock = clock
        self.arrival = threading.Condition()
        self.commanding = threading.RLock()
        self.stopped = False
        self._network: _Network | None = None
        self._pending: set[int] = set()
        self._owed: dict[int, int] = {}  # by each node that ever answered: to how many SYNCs it did not yet
        self._loss: Exception | None = None
        self._heartbeat: _HostHeartbeat | None = None
        self._lock: BusLock | None = None

    @property
    def network(self) -> _Network:
        if self._network is None:
            raise BusLost(self.config.name, "not open")
        return self._network

    @property
    def is_open(self) -> bool:
        return self._network is not None

    def open(self) -> None:
        if self._network is not None:
            return
        self._loss = None
        lock = BusLock(self.config.name, self.config.can)
        try:
            network = self._connected()
        except BaseException:
            lock.release()
            raise
        self._lock, self._network = lock, network

    def begin_heartbeat(self) -> None:
        """Where the drives are to watch one. Not before they are started: who only looks leaves no watch armed."""
        if self.config.host_node_id is not None and self._heartbeat is None:
            period = self.config.host_heartbeat_period
            self._heartbeat = _HostHeartbeat(self.network, self.config.host_node_id, period)

    def _connected(self) -> _Network:
        network = _Network(self.config.name)
        network.listeners.append(_LossListener(self))  # type: ignore[arg-type]
        network.NOTIFIER_CYCLE = 0.02  # how long closing may take; the default is a second
        try:
            network.connect(ignore_config=True, **self.config.can)
        except (can.CanError, OSError, ValueError, NotImplementedError, ImportError) as error:
            raise BusLost(self.config.name, f"cannot be opened: {error}") from error
        except (TypeError, KeyError, AttributeError) as error:  # by which python-can refuses its arguments
            raise SiteError(f"{self.config.name}: 'can.bus' of the site file {_what_is_wrong(error)}") from error
        except Exception as error:  # kvaser's without its maker's library: NameError
            raise BusLost(self.config.name, f"cannot be opened: {type(error).__name__}: {error}") from error
        if (port := getattr(network.bus, "serialPortOrig", None)) is not None:  # slcan's
            port.flush = lambda: None  # it waits, for ever, until the adapter has taken all; a write has its time limit
        return network

    def close(self) -> None:
        if self._heartbeat is not None:
            self._heartbeat.end()
            self._heartbeat = None
        network, self._network = self._network, None
        if network is None:
            return
        try:
            network.disconnect()
        except Exception as error:  # also whatever has ended the receiving thread
            log.warning("%s: closed after it was lost: %s", self.config.name, error)
        finally:
            if self._lock is not None:
                self._lock.release()

    def check(self) -> None:
        self.network.check()
        if self._heartbeat is not None and self._heartbeat.failure is not None:
            raise BusLost(self.config.name, f"this program's heartbeat: {self._heartbeat.failure.cause}")

    def lost(self, error: Exception) -> None:
        """The receiving thread failed; called in it. Left alone it would end with a traceback for the operator."""
        if self._network is not None and self._network.notifier is not None:
            self._network.notifier.stop(timeout=0)
        with self.arrival:
            self._loss = error
            self.arrival.notify_all()

    def send(self, can_id: int, data: bytes) -> None:
        self.network.send_message(can_id, data)

    def sync(self) -> None:
        with self.arrival:
            self._owed = {node: answers + 1 for node, answers in self._owed.items()}
        self.send(0x80, b"")

    def answered(self, seconds: float) -> None:
        """Wait, for so long at most, until every SYNC was answered: who asks afterwards hears no older answer."""
        with self.arrival:
            self.clock.wait_for(self.arrival, lambda: not any(self._owed.values()) or self._loss is not None, seconds)
            self._owed = dict.fromkeys(self._owed, 0)

    def received(self, node_id: int) -> None:
        """Process data of `node_id` came in; called from the receiving thread."""
        with self.arrival:
            self._pending.discard(node_id)
            self._owed[node_id] = max(0, self._owed.get(node_id, 0) - 1)
            if not self._pending or not any(self._owed.values()):
                self.arrival.notify_all()

    def hears_heartbeat(self, node_id: int, seconds: float) -> bool:
        """Whether that node says that it lives within this time."""
        heard = threading.Event()

        def hear(*_: Any) -> None:
            with self.arrival:
                heard.set()
                self.arrival.notify_all()

        self.network.subscribe(0x700 + node_id, hear)
        try:
            with self.arrival:
                return bool(self.clock.wait_for(self.arrival, heard.is_set, seconds))
        finally:
            self.network.unsubscribe(0x700 + node_id, hear)

    def exchange(self, node_ids: Collection[int]) -> set[int]:
        """One SYNC, and process data from each node. Returns the nodes that stayed silent."""
        with self.arrival:
            self._pending = set(node_ids)
        self.sync()
        with self.arrival:
            self.clock.wait_for(
                self.arrival, lambda: not self._pending or self._loss is not None, self.config.answer_timeout
            )
            silent = set(self._pending)
            self._owed |= dict.fromkeys(silent & self._owed.keys(), 0)
        if silent:
            self.check()
        return silent


class _Network(canopen.Network):
    """canopen's, of which every failure is BusLost, also inside its SDO client and its PDO maps.

    python-can may raise anything: a garbled line ends the receiving thread by ValueError, and from then on canopen
    raises it from every send, although the message has gone out. canopen's own send has no time limit.
    """

    def __init__(self, name: str) -> None:
        super().__init__()
        self._name = name

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        try:
            if self.bus is None:
                raise RuntimeError("not connected")
            extended = can_id > 0x7FF
            message = can.Message(arbitration_id=can_id, is_extended_id=extended, data=data, is_remote_frame=remote)
            with self.send_lock:
                self.bus.send(message, timeout=SEND_S)
            self.check()
        except BusLost:
            raise
        except Exception as error:
            raise BusLost(self._name, f"cannot send: {error}") from error

    def check(self) -> None:
        try:
            super().check()
        except (ValueError, LookupError) as error:
            raise BusLost(self._name, f"what came over it is no CAN frame: {error}") from error
        except Exception as error:
            raise BusLost(self._name, str(error)) from error


class _HostHeartbeat:
    """The heartbeat by which drives know that this program lives; in real time, on a thread of its own.

    Not python-can's periodic task: that one ends for good, with a traceback for the operator, when a single message
    could not be sent, and nobody is told.

    failure   why it has ended by itself
    """

    def __init__(self, network: _Network, node_id: int, period: float) -> None:
        self.failure: BusLost | None = None
        self._network, self._cob_id, self._period = network, 0x700 + node_id, period
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name="host heartbeat", daemon=True)
        self._thread.start()

    def end(self) -> None:
        self._ended.set()
        self._thread.join(timeout=1.0)

    def _run(self) -> None:
        failed = 0
        while failed < HEARTBEATS_MISSED:
            try:
                self._network.send_message(self._cob_id, b"\x05")
                failed = 0
            except BusLost as error:
                failed += 1
                if failed == HEARTBEATS_MISSED:
                    self.failure = error
            if self._ended.wait(self._period):
                return


class _LossListener(can.Listener):
    """python-can tells listeners when receiving fails; canopen's own takes no interest."""

    def __init__(self, bus: CanBus) -> None:
        self._bus = bus

    def on_message_received(self, msg: can.Message) -> None:
        pass

    def on_error(self, exc: Exception) -> None:
        self._bus.lost(exc)


def _what_is_wrong(error: Exception) -> str:
    text = str(error)
    lacking = re.findall(r"'(\w+)'", text) if isinstance(error, KeyError) or " missing " in text else []
    return f"lacks {', '.join(lacking)}" if lacking else f"cannot be used: {text}"


@dataclass(frozen=True)
class Entry:
    """An object of the standard: address and struct format, so that no maker's EDS is needed to talk to a drive."""

    index: int
    subindex: int
    format: str
    name: str

    def __str__(self) -> str:
        return f"{self.name} 0x{self.index:04X}:{self.subindex:02X}"


class SdoPort:
    """Object access on one node, one transfer at a time. Nothing is retried."""

    def __init__(self, device: str, node: canopen.RemoteNode, bus: CanBus) -> None:
        self._device = device
        self._sdo = node.sdo
        self._sdo.RESPONSE_TIMEOUT = bus.config.sdo_timeout
        self._bus = bus
        self._lock = threading.Lock()

    def read(self, entry: Entry) -> int:
        value = self.read_if_present(entry)
        if value is None:
            raise ConfigurationMismatch(self._device, f"has no {entry}")
        return value

    def read_if_present(self, entry: Entry) -> int | None:
        raw = self.upload(entry)
        if raw is None:
            return None
        size = struct.calcsize(entry.format)
        if len(raw) < size:
            raise ProtocolError(self._device, f"the SDO answer on {entry} has {len(raw)} bytes, expected {size}")
        # some drives answer with four bytes whatever the object's size
        return int(struct.unpack("<" + entry.format, raw[:size])[0])

    def text_if_present(self, index: int) -> str | None:
        raw = self.upload(Entry(index, 0, "", "text"))
        return None if raw is None else raw.rstrip(b"\0").decode("latin-1").strip()

    def write(self, entry: Entry, value: int) -> None:
        if not self.write_if_present(entry, value):
            raise ConfigurationMismatch(self._device, f"has no {entry}")

    def write_if_present(self, entry: Entry, value: int) -> bool:
        try:
            data = struct.pack("<" + entry.format, value)
        except struct.error as error:
            raise ConfigurationMismatch(self._device, f"{entry}: {value} does not fit: {error}") from error
        try:
            self._transfer(entry, data)
        except SdoAbortedError as error:
            if error.code in NO_SUCH_OBJECT:
                return False
            raise ConfigurationMismatch(self._device, f"{entry}: {value} refused: {error}") from error
        return True

    def set(self, entry: Entry, value: int) -> None:
        """Write, read back, compare."""
        self.write(entry, value)
        self._compare(entry, value)

    def set_if_present(self, entry: Entry, value: int) -> bool:
        if not self.write_if_present(entry, value):
            return False
        self._compare(entry, value)
        return True

    def set_asked(self, entry: Entry, value: int, key: str) -> None:
        """What the site file gives under `key` is not left out where the drive has no such object."""
        if not self.set_if_present(entry, value):
            raise ConfigurationMismatch(self._device, f"has no {entry}, but the site file gives {key}")

    def upload(self, entry: Entry) -> bytes | None:
        """Raw bytes, or None when the drive has no such object."""
        try:
            return self._transfer(entry, None)
        except SdoAbortedError as error:
            if error.code in NO_SUCH_OBJECT:
                return None
            raise ConfigurationMismatch(self._device, f"{entry} cannot be read: {error}") from error

    def _compare(self, entry: Entry, value: int) -> None:
        found = self.read(entry)
        if found != value:
            raise ConfigurationMismatch(self._device, f"{entry}: wrote {value}, read back {found}")

    def _transfer(self, entry: Entry, data: bytes | None) -> bytes:
        with self.answered(str(entry)):
            if data is None:
                return bytes(self._sdo.upload(entry.index, entry.subindex))
            self._sdo.download(entry.index, entry.subindex, data)
            return b""

    @contextmanager
    def answered(self, what: str) -> Iterator[None]:
        """One transfer at a time; what canopen raises inside says who was asked what. A refusal (SdoAbortedError) is
        left to whoever asked."""
        with self._lock:
            try:
                yield
            except SdoCommunicationError as error:
                self._bus.check()
                if str(error) != NO_ANSWER:
                    other = f"the SDO answer on {what} is none to it; does another program speak to this drive?"
                    raise ProtocolError(self._device, f"{other} ({error})") from error
                waited = self._bus.config.sdo_timeout
                raise HardwareTimeout(self._device, f"no SDO answer on {what} within {waited:g} s") from error
            except struct.error as error:
                raise ProtocolError(self._device, f"the SDO answer on {what} is cut short: {error}") from error
