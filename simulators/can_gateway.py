"""A USB-CAN adapter over TCP: bridges a `virtual` CAN channel to clients that speak slcan (LAWICEL ASCII).

A simulated machine in a process of its own is then configured exactly like a real adapter:

    can: {interface: slcan, channel: "socket://127.0.0.1:29401", bitrate: 500000, sleep_after_open: 0}

Frames: `tIIILDD…`, `TIIIIIIIILDD…` (extended), `r`/`R` (remote); commands `S0`–`S8`, `O`, `L`, `C`, `V`, `N`, `F`;
each is answered by CR, or BEL when it is not understood.

Faults, once each: garble(), a character of a frame to the clients that is no hexadecimal digit; cut(), half a frame.

Known limitations: bits per second and arbitration are not simulated; no time stamps, no CAN FD; a listen-only client
is not kept from sending.
"""

from __future__ import annotations

import contextlib
import logging
import socket
import threading
from collections.abc import Callable, Iterator

import can

log = logging.getLogger(__name__)

OK, ERROR = b"\r", b"\a"
ANSWERS = {"V": b"V1013\r", "N": b"NSIM1\r", "F": b"F00\r"}


def encode(message: can.Message) -> bytes:
    letter = "r" if message.is_remote_frame else "t"
    identifier = f"{message.arbitration_id:03X}"
    if message.is_extended_id:
        letter, identifier = letter.upper(), f"{message.arbitration_id:08X}"
    data = "" if message.is_remote_frame else message.data.hex().upper()
    return f"{letter}{identifier}{message.dlc:d}{data}\r".encode()


def decode(line: str) -> can.Message:
    """One frame; ValueError when it is none."""
    letter, width = line[0], 8 if line[0] in "TR" else 3
    length = int(line[1 + width])
    remote = letter in "rR"
    data = b"" if remote else bytes.fromhex(line[2 + width :])
    if length > 8 or (not remote and len(data) != length):
        raise ValueError(f"{line!r}: {length} bytes announced, {len(data)} there")
    return can.Message(
        arbitration_id=int(line[1 : 1 + width], 16),
        is_extended_id=width == 8,
        is_remote_frame=remote,
        dlc=length,
        data=data,
    )


class SlcanGateway:
    """Listens on `host:port` (0: any free one, see `port`) until close()."""

    def __init__(self, channel: str, host: str = "127.0.0.1", port: int = 0) -> None:
        self._bus = can.Bus(interface="virtual", channel=channel, ignore_config=True)
        self._server = socket.create_server((host, port))
        self.host, self.port = host, int(self._server.getsockname()[1])
        self._clients: list[_Client] = []
        self._lock = threading.Lock()
        self._closing = threading.Event()
        self._spoil: Callable[[bytes], bytes] | None = None
        self._whole_before = 0
        self._threads = [threading.Thread(target=run, daemon=True) for run in (self._accept, self._forward)]
        for thread in self._threads:
            thread.start()

    @property
    def url(self) -> str:
        return f"socket://{self.host}:{self.port}"

    def garble(self, after: int = 0) -> None:
        """After so many whole frames; the line between adapter and host has no checksum."""
        self._whole_before, self._spoil = after, lambda line: line[:6] + b"Z" + line[7:]

    def cut(self, after: int = 0) -> None:
        self._whole_before, self._spoil = after, lambda line: line[: 5 + 2 * ((len(line) - 6) // 4)] + b"\r"

    def close(self) -> None:
        """As if the adapter were pulled: clients find their connection closed."""
        self._closing.set()
        with contextlib.suppress(OSError):
            self._server.shutdown(socket.SHUT_RDWR)
        self._server.close()
        for client in self._connected():
            client.hang_up()
        for thread in self._threads:
            thread.join(timeout=2.0)
        self._bus.shutdown()

    def __enter__(self) -> SlcanGateway:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _connected(self) -> list[_Client]:
        with self._lock:
            return list(self._clients)

    def _accept(self) -> None:
        while not self._closing.is_set():
            try:
                connection, _ = self._server.accept()
            except OSError:  # closed
                return
            client = _Client(connection)
            with self._lock:
                self._clients.append(client)
            threading.Thread(target=self._serve, args=(client,), daemon=True).start()

    def _forward(self) -> None:
        """From the bus to every open client."""
        while not self._closing.is_set():
            message = self._bus.recv(0.1)
            if message is not None:
                self._broadcast(message, None)

    def _broadcast(self, message: can.Message, sender: _Client | None) -> None:
        for client in self._connected():
            if client is not sender and client.is_open:
                client.send(self._spoiled(encode(message)))

    def _spoiled(self, line: bytes) -> bytes:
        if self._spoil is None or len(line) < 8:
            return line
        if self._whole_before:
            self._whole_before -= 1
            return line
        spoil, self._spoil = self._spoil, None
        return spoil(line)

    def _serve(self, client: _Client) -> None:
        try:
            for line in client.lines():
                client.send(self._obey(client, line))
        except OSError as error:
            log.info("client gone: %s", error)
        finally:
            client.hang_up()
            with self._lock:
                self._clients.remove(client)

    def _obey(self, client: _Client, line: str) -> bytes:
        if line[:1] in ("t", "T", "r", "R"):
            try:
                message = decode(line)
            except (ValueError, IndexError) as error:
                log.warning("not a frame: %s", error)
                return ERROR
            if not client.is_open:
                return ERROR
            self._bus.send(message)
            self._broadcast(message, client)
            return OK
        if line in ("O", "L"):
            client.is_open = True
        elif line == "C":
            client.is_open = False
        elif line in ANSWERS:
            return ANSWERS[line]
        elif line and line[0] not in "SsYZMmX":
            return ERROR
        return OK


class _Client:
    def __init__(self, connection: socket.socket) -> None:
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.is_open = False
        self._connection = connection
        self._sending = threading.Lock()

    def lines(self) -> Iterator[str]:
        """What the client sends, split at CR, until it hangs up."""
        buffer = bytearray()
        while received := self._connection.recv(4096):
            buffer += received
            while (end := buffer.find(b"\r")) >= 0:
                yield buffer[:end].decode("ascii", "replace")
                del buffer[: end + 1]

    def send(self, data: bytes) -> None:
        with self._sending, contextlib.suppress(OSError):  # its own thread sees the loss and cleans up
            self._connection.sendall(data)

    def hang_up(self) -> None:
        with contextlib.suppress(OSError):
            self._connection.shutdown(socket.SHUT_RDWR)
        self._connection.close()
