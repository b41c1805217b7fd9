"""Connect to a cube over this computer's Bluetooth adapter, with the library bleak.

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
NOTIFIED_CHARACTERISTICS = (Characteristic.ID, Characteristic.BATTERY, Characteristic.CONFIGURATION)
"""Characteristics whose notifications the port subscribes to."""


def is_cube(name_or_address: str, name: str | None, address: str) -> bool:
    """Check whether a Bluetooth advertisement belongs to the wanted cube.

    Args:
        name_or_address: The address or the name of the wanted cube. An address can be in upper or
            lower case. A name such as `toio-M0p` can be shortened to the part after the last
            hyphen, `M0p`, which must have the right case.
        name: Name in the advertisement. None if the advertisement has no name.
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
        self._is_ready = threading.Event()
        self._loop = asyncio.new_event_loop()
        self._client: Any = None
        self._close_requested = asyncio.Event()
        self._unpacker = Unpacker()
        self._collected_messages = b""

    def open(self, exclusive: bool = True) -> None:
        """Find the cube and connect to it, within CONNECT_S seconds. `exclusive` is ignored.

        Raises:
            AbortError: If the cube is not found or does not answer.
        """
        self._thread.start()
        if not self._is_ready.wait(CONNECT_S) or self.failure:
            self.close()
            raise AbortError(self.failure or f"the cube {self._device} does not answer", self._hint)

    def write(self, data: bytes) -> int:
        """Send packed messages to the cube: a write, or a read request if a message has no data.

        Returns:
            The time at which the messages were handed to the operating system [ns].

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
            self._loop.call_soon_threadsafe(self._close_requested.set)
        super().close()

    def _read(self) -> None:
        """Run the connection's event loop in the reader thread."""
        with suppress(Exception):
            self._loop.run_until_complete(self._serve())
        self._loop.close()

    async def _serve(self) -> None:
        """Keep the connection until the port is closed, and record why it fails. Never raises."""
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
            self._is_ready.set()

    async def _stay_connected(self) -> None:
        """Find the cube, subscribe to its notifications, and wait until the port is closed.

        If the cube is not found within FIND_S seconds, the port's failure is set.
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
            for characteristic in NOTIFIED_CHARACTERISTICS:
                await client.start_notify(
                    characteristic.uuid,
                    lambda _, data, source=characteristic: self._collect(source, data),
                )
            self._client = client
            self._is_ready.set()
            await self._close_requested.wait()
            self._client = None

    async def _send(self, characteristic: Characteristic, payload: bytes) -> None:
        """Send a message to the cube: a write, or a read request if the payload is empty.

        Without a connection, nothing happens. An error counts as a loss of the connection.
        """
        client = self._client
        if client is None:
            return
        try:
            if payload:
                with_answer = characteristic is Characteristic.CONFIGURATION
                await client.write_gatt_char(characteristic.uuid, payload, response=with_answer)
            else:
                self._collect(characteristic, await client.read_gatt_char(characteristic.uuid))
        except Exception as error:  # the backends raise various errors
            self._report_loss(str(error) or type(error).__name__)

    def _collect(self, characteristic: Characteristic, data: bytearray | bytes) -> None:
        """Collect a message, so that all messages of a connection event are passed on together.

        If messages were passed on one by one, an older reading would seem as new as the newest
        reading.
        """
        if not self._collected_messages:
            self._loop.call_later(SAME_EVENT_S, self._deliver_collected, self._clock.now())
        self._collected_messages += pack(characteristic, bytes(data))

    def _deliver_collected(self, arrival_ns: int) -> None:
        """Pass on the collected messages with the time at which the first message arrived [ns]."""
        messages = self._collected_messages
        self._collected_messages = b""
        self._on_received(messages, arrival_ns)

    def _report_disconnection(self, _: Any) -> None:
        """Report a lost connection, unless the port is being closed."""
        if not self._closing.is_set():
            self._report_loss("disconnected")

    def _report_loss(self, reason: str) -> None:
        """Record why the connection was lost, and notify the receiver."""
        self._fail(f"is gone: {reason}")
        self._on_received(b"", self._clock.now())
