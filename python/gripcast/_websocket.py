"""The client's side of a WebSocket (RFC 6455), for the daemon's events."""

from __future__ import annotations

import base64
import hashlib
import os
import socket
import struct
from http.client import HTTPConnection, HTTPResponse

_GUID = b"258EAFA5-E914-47DA-95CA-C5AB0DC85B11"
_CONTINUATION, _TEXT, _BINARY, _CLOSE, _PING, _PONG = 0x0, 0x1, 0x2, 0x8, 0x9, 0xA
# A state of the daemon has some kilobytes.
_MAX_MESSAGE_BYTES = 16 << 20


class Refused(Exception):
    """The server answered the handshake with an HTTP response."""

    def __init__(self, response: HTTPResponse) -> None:
        super().__init__(response.status)
        self.response = response


class WebSocket:
    """Receives text messages; pings are answered."""

    def __init__(self, connection: HTTPConnection, path: str, headers: dict[str, str]) -> None:
        key = base64.b64encode(os.urandom(16))
        upgrade = {
            "Connection": "Upgrade",
            "Upgrade": "websocket",
            "Sec-WebSocket-Key": key.decode(),
            "Sec-WebSocket-Version": "13",
        }
        connection.request("GET", path, headers={**headers, **upgrade})
        # The socket, before the response may close it.
        sock = connection.sock
        response = connection.getresponse()
        if response.status != 101:
            raise Refused(response)
        accept = base64.b64encode(hashlib.sha1(key + _GUID).digest()).decode()
        if response.headers.get("Sec-WebSocket-Accept") != accept:
            raise OSError("the server does not speak WebSocket")
        self._connection = connection
        self._socket: socket.socket = sock
        # What the response has read ahead is the start of the messages.
        self._stream = response.fp
        response.fp = None  # type: ignore[assignment]

    def receive(self) -> str | None:
        """The next text message; None after the end."""
        message = b""
        while True:
            final, opcode, payload = self._frame()
            if opcode == _CLOSE:
                return None
            if opcode == _PING:
                self._send(_PONG, payload)
                continue
            if opcode == _PONG:
                continue
            if opcode == _BINARY:
                raise OSError("a binary message, which was not asked for")
            if opcode not in (_TEXT, _CONTINUATION):
                raise OSError(f"an invalid WebSocket opcode, {opcode:#x}")
            message += payload
            if len(message) > _MAX_MESSAGE_BYTES:
                raise OSError(f"a message above {_MAX_MESSAGE_BYTES} bytes")
            if final:
                return message.decode()

    def close(self) -> None:
        """Ends the connection; a `receive` in another thread ends, too."""
        try:
            self._socket.shutdown(socket.SHUT_RDWR)
        except OSError:
            # It has ended already.
            pass
        self._stream.close()
        self._connection.close()

    def _frame(self) -> tuple[bool, int, bytes]:
        first, second = self._read(2)
        length = second & 0x7F
        if length == 126:
            (length,) = struct.unpack(">H", self._read(2))
        elif length == 127:
            (length,) = struct.unpack(">Q", self._read(8))
        if length > _MAX_MESSAGE_BYTES:
            raise OSError(f"a message above {_MAX_MESSAGE_BYTES} bytes")
        if second & 0x80:
            raise OSError("the server masks its messages")
        return bool(first & 0x80), first & 0x0F, self._read(length)

    def _read(self, count: int) -> bytes:
        data = self._stream.read(count)
        if data is None or len(data) < count:
            raise ConnectionResetError("the connection has ended")
        return data

    def _send(self, opcode: int, payload: bytes) -> None:
        # Control messages have at most 125 bytes.
        mask = os.urandom(4)
        masked = bytes(byte ^ mask[index % 4] for index, byte in enumerate(payload))
        self._socket.sendall(bytes([0x80 | opcode, 0x80 | len(payload)]) + mask + masked)
