"""Connects to a cube over this computer's Bluetooth adapter, with the library bleak.

This module has never been tried with a real cube.
"""

import asyncio
import threading
from contextlib import suppress
from typing import Any

from tetractl.core.clock import Clock
from tetractl.core.errors import AbortError
from tetractl.lab.serial_port import OnReceived, SerialPort
from tetractl_toio.messages import SAME_EVENT_S, SERVICE, Characteristic, Unpacker, pack

FIND_S = 10.0
"""Maximum duration of the search for a cube [s]."""
CONNECT_S = 20.0
"""Maximum time until a cube is connected and sends notifications [s]."""
NOTIFIED = (Characteristic.ID, Characteristic.BATTERY, Characteristic.CONFIGURATION)
"""Characteristics whose notifications the port subscribes to."""


def is_cube(name_or_address: str, name: str | None, address: str) -> bool:
    """Check whether a Bluetooth advertisement belongs to the wanted cube.

    Args:
        name_or_address: The cube's address, in upper or lower case, or its name such as
            `toio-M0p`, or only the last three letters of its name. Of a name, only the part after
            the last hyphen is compared, and upper and lower case differ.
        name: Name in the advertisement. None if it has none.
        address: Address of the advertiser.
    """
    last_letters = name_or_address.rpartition("-")[2]
    return (
        name_or_address.casefold() == address.casefold()
        or last_letters in (name or "").replace("(toio Core Cube)", "").strip().split("-")[1:]
    )


class BluetoothPort(SerialPort):
    """The Bluetooth connection to one cube, with the interface of a serial port.

    Args:
        name: Name or address of the cube.
        baud: Ignored. Serial ports need it.
        device: What the messages call the connected device.
        clock: The clock of all times.
        on_received: Called with received bytes and their time [ns]; see `SerialPort`.
        hint: The hint of the errors raised.
    """

    def __init__(
        self, name: str, baud: int, device: str, clock: Clock, on_received: OnReceived, hint: str
    ) -> None:
        super().__init__(name, baud, device, clock, on_received, hint)
        self._ready = threading.Event()
        self._loop = asyncio.new_event_loop()
        self._client: Any = None
        self._close_asked = asyncio.Event()
        self._unpacker = Unpacker()
        self._collected = b""

    def open(self, exclusive: bool = True) -> None:
        """Find the cube and connect to it, within CONNECT_S seconds. `exclusive` is ignored.

        Raises:
            AbortError: If the cube is not found or does not answer.
        """
        self._thread.start()
        if not self._ready.wait(CONNECT_S) or self.failure:
            self.close()
            raise AbortError(self.failure or f"the cube {self._device} does not answer", self._hint)

    def write(self, data: bytes) -> int:
        """Send each of the packed messages: as a write or, if it has no data, as a read request.

        Returns:
            The time at which they were handed to the operating system [ns].

        Raises:
            AbortError: If the cube is not connected.
        """
        if self.failure or self._client is None:
            raise AbortError(
                self.failure or f"the cube {self._device} is not connected", self._hint
            )
        for characteristic, payload in self._unpacker.feed(data):
            sending = self._send(Characteristic(characteristic), payload)
            asyncio.run_coroutine_threadsafe(sending, self._loop)
        return self._clock.now()

    def close(self) -> None:
        """Disconnect and stop the thread. This method can be called repeatedly and never raises."""
        self._closing.set()
        with suppress(RuntimeError):
            self._loop.call_soon_threadsafe(self._close_asked.set)
        super().close()

    def _read(self) -> None:
        """Run the connection's event loop in the reader thread."""
        with suppress(Exception):
            self._loop.run_until_complete(self._serve())
        self._loop.close()

    async def _serve(self) -> None:
        """Keep the connection until it is closed, and record why it failed. No error is raised."""
        try:
            await self._stay_connected()
        except ImportError:
            self._fail("needs bleak: pip install bleak")
        except FileNotFoundError:
            self._fail(
                "cannot be connected, because this computer's Bluetooth service is not running"
            )
        except Exception as error:  # bleak's backends raise what their systems do
            self._fail(f"cannot be connected: {str(error) or type(error).__name__}")
        finally:
            self._ready.set()

    async def _stay_connected(self) -> None:
        """Find the cube, subscribe to its notifications, and wait until the port is closed.

        If the cube is not found within FIND_S seconds, this is recorded as the failure.
        """
        from bleak import BleakClient, BleakScanner

        cube = await BleakScanner.find_device_by_filter(
            lambda device, advertisement: is_cube(
                self._name, advertisement.local_name or device.name, device.address
            ),
            timeout=FIND_S,
            service_uuids=[SERVICE],
        )
        if cube is None:
            self._fail(f"was not found within {FIND_S:g} s")
            return
        async with BleakClient(cube, disconnected_callback=self._report_disconnection) as client:
            for kind in NOTIFIED:
                await client.start_notify(kind.uuid, lambda _, data, k=kind: self._collect(k, data))
            self._client = client
            self._ready.set()
            await self._close_asked.wait()
            self._client = None

    async def _send(self, kind: Characteristic, payload: bytes) -> None:
        """Send one message to the cube: a write, or a read if the payload is empty.

        Nothing happens without a connection. An error is recorded as a loss of the connection.
        """
        client = self._client
        if client is None:
            return
        try:
            if payload:
                with_answer = kind is Characteristic.CONFIGURATION
                await client.write_gatt_char(kind.uuid, payload, response=with_answer)
            else:
                self._collect(kind, await client.read_gatt_char(kind.uuid))
        except Exception as error:  # as above
            self._report_loss(str(error) or type(error).__name__)

    def _collect(self, kind: Characteristic, data: bytearray | bytes) -> None:
        """Collect a message, so that messages of one connection event are passed on together.

        If they were passed on one by one, an older reading would seem as new as the latest one.
        """
        if not self._collected:
            self._loop.call_later(SAME_EVENT_S, self._deliver_collected, self._clock.now())
        self._collected += pack(kind, bytes(data))

    def _deliver_collected(self, at_ns: int) -> None:
        """Pass on the collected messages with the time at which the first one arrived [ns]."""
        collected = self._collected
        self._collected = b""
        self._on_received(collected, at_ns)

    def _report_disconnection(self, _: Any) -> None:
        """Report a lost connection, unless the port is being closed."""
        if not self._closing.is_set():
            self._report_loss("disconnected")

    def _report_loss(self, reason: str) -> None:
        """Record why the connection was lost, and notify the reader."""
        self._fail(f"is gone: {reason}")
        self._on_received(b"", self._clock.now())
