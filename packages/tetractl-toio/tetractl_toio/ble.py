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
from tetractl_toio.messages import SERVICE, TOGETHER_S, Characteristic, Unpacker, pack

FIND_S = 10.0  # longest search for a cube
CONNECT_S = 20.0  # longest time until it is connected and notifies
NOTIFYING = (Characteristic.ID, Characteristic.BATTERY, Characteristic.CONFIGURATION)


def is_cube(wanted: str, name: str | None, address: str) -> bool:
    """Check whether a Bluetooth advertisement belongs to the wanted cube.

    Args:
        wanted: The cube's address, or its name such as `toio-M0p`, or only the last three letters
            of its name.
        name: Name in the advertisement. None if it has none.
        address: Address of the advertiser.
    """
    letters = wanted.rpartition("-")[2]
    return (
        wanted.casefold() == address.casefold()
        or letters in (name or "").replace("(toio Core Cube)", "").strip().split("-")[1:]
    )


class BluetoothPort(SerialPort):
    """The Bluetooth connection to one cube, with the interface of a serial port.

    The arguments are those of `SerialPort`: `name` is the cube's name or address, and `baud` is
    ignored.

    Args:
        name: Name of the cube.
        baud: Without meaning here.
        device: What is connected, for messages.
        clock: The clock for times.
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
        self._ended = asyncio.Event()
        self._unpacker = Unpacker()
        self._together = b""

    def open(self, alone: bool = True) -> None:
        """Find the cube and connect to it, within CONNECT_S seconds. `alone` is ignored.

        Raises:
            AbortError: If the cube is not found or does not answer.
        """
        self._thread.start()
        if not self._ready.wait(CONNECT_S) or self.failure:
            self.close()
            raise AbortError(self.failure or f"the cube {self._device} does not answer", self._hint)

    def write(self, data: bytes) -> int:
        """Send packed messages as writes or, if they have no data, as read requests.

        Returns:
            The time at which they were handed to the operating system [ns].

        Raises:
            AbortError: If the cube is not connected.
        """
        if self.failure or self._client is None:
            raise AbortError(
                self.failure or f"the cube {self._device} is not connected", self._hint
            )
        for number, payload in self._unpacker.feed(data):
            call = self._pass(Characteristic(number), payload)
            asyncio.run_coroutine_threadsafe(call, self._loop)
        return self._clock.now()

    def close(self) -> None:
        """Disconnect and stop the thread. This method can be called repeatedly and never raises."""
        self._closing.set()
        with suppress(RuntimeError):
            self._loop.call_soon_threadsafe(self._ended.set)
        super().close()

    def _read(self) -> None:
        """Run the connection's event loop in the reader thread."""
        with suppress(Exception):
            self._loop.run_until_complete(self._serve())
        self._loop.close()

    async def _serve(self) -> None:
        """Keep the connection until it is closed, and record why it failed. No error is raised."""
        try:
            await self._connected()
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

    async def _connected(self) -> None:
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
        async with BleakClient(cube, disconnected_callback=self._gone) as client:
            for kind in NOTIFYING:
                await client.start_notify(kind.uuid, lambda _, data, k=kind: self._take(k, data))
            self._client = client
            self._ready.set()
            await self._ended.wait()
            self._client = None

    async def _pass(self, kind: Characteristic, payload: bytes) -> None:
        """Send one message to the cube: a write, or a read if the payload is empty.

        Nothing happens without a connection. An error is recorded as the connection's
        loss.
        """
        client = self._client
        if client is None:
            return
        try:
            if payload:
                with_answer = kind is Characteristic.CONFIGURATION
                await client.write_gatt_char(kind.uuid, payload, response=with_answer)
            else:
                self._take(kind, await client.read_gatt_char(kind.uuid))
        except Exception as error:  # as above
            self._lost(str(error) or type(error).__name__)

    def _take(self, kind: Characteristic, data: bytearray | bytes) -> None:
        """Collect a message, so that messages of one connection event are passed on together.

        If they were passed on one by one, an older reading would seem as new as the latest one.
        """
        if not self._together:
            self._loop.call_later(TOGETHER_S, self._pass_on, self._clock.now())
        self._together += pack(kind, bytes(data))

    def _pass_on(self, at_ns: int) -> None:
        """Pass on the collected messages with the time at which the first one arrived [ns]."""
        together = self._together
        self._together = b""
        self._on_received(together, at_ns)

    def _gone(self, _: Any) -> None:
        """Report a lost connection, unless the port is being closed."""
        if not self._closing.is_set():
            self._lost("disconnected")

    def _lost(self, why: str) -> None:
        """Record why the connection was lost, and notify the reader."""
        self._fail(f"is gone: {why}")
        self._on_received(b"", self._clock.now())
