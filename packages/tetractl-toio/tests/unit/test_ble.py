"""Tests of the Bluetooth port to a cube, with a fake of the library bleak."""

import queue
import sys
from types import ModuleType, SimpleNamespace

import pytest
from tetractl_toio.ble import BluetoothPort, is_cube
from tetractl_toio.messages import SERVICE, Characteristic, encode_motor, pack

from tetractl.core.clock import MonotonicClock
from tetractl.core.errors import AbortError

pytestmark = pytest.mark.slow
MOTOR = encode_motor(20, -20, 250)


class Air:
    """What is in radio range, and what was written to it."""

    def __init__(self, *names, breaks=False):
        self.names = names
        self.breaks = breaks
        self.written = queue.Queue()
        self.notified = {}
        self.gone = None

    def module(self):
        air = self

        class BleakScanner:
            """Stands in for bleak's scanner: finds the devices in the air."""

            @staticmethod
            async def find_device_by_filter(fits, timeout, service_uuids):
                assert service_uuids == [SERVICE] and timeout > 0
                for name in air.names:
                    device = SimpleNamespace(name=None, address="c0:ff:ee:00:00:01")
                    if fits(device, SimpleNamespace(local_name=name)):
                        return device
                return None

        class BleakClient:
            """Stands in for bleak's connection to one device: keeps what is written to it."""

            def __init__(self, device, disconnected_callback):
                air.gone = disconnected_callback

            async def __aenter__(self):
                if air.breaks:
                    raise OSError("no adapter")
                return self

            async def __aexit__(self, *_):
                air.written.put("disconnected")

            async def start_notify(self, uuid, take):
                air.notified[uuid] = take

            async def write_gatt_char(self, uuid, data, response):
                air.written.put((uuid, bytes(data), response))

            async def read_gatt_char(self, uuid):
                return bytearray([80])

        module = ModuleType("bleak")
        module.BleakScanner = BleakScanner
        module.BleakClient = BleakClient
        return module


@pytest.fixture
def connect(monkeypatch):
    opened = []

    def connect(air):
        monkeypatch.setitem(sys.modules, "bleak", air.module())
        heard = queue.Queue()

        def take(data, at_ns):
            heard.put(data)

        port = BluetoothPort("toio-M0p", 0, "the cube", MonotonicClock(), take, "hint")
        opened.append(port)
        return port, heard

    yield connect
    for port in opened:
        port.close()


def test_messages_become_writes_reads_and_notifications(connect):
    air = Air("toio-C3P", "toio-M0p")
    port, heard = connect(air)
    port.open()
    assert set(air.notified) == {
        kind.uuid
        for kind in (Characteristic.ID, Characteristic.BATTERY, Characteristic.CONFIGURATION)
    }
    port.write(pack(Characteristic.MOTOR, MOTOR) + pack(Characteristic.BATTERY))
    assert air.written.get(timeout=60) == (Characteristic.MOTOR.uuid, MOTOR, False)
    assert heard.get(timeout=60) == pack(Characteristic.BATTERY, bytes([80]))
    for data in (b"\x03", b"\x04"):  # of one event of the connection
        port._loop.call_soon_threadsafe(air.notified[Characteristic.ID.uuid], None, bytearray(data))
    assert heard.get(timeout=60) == b"".join(pack(Characteristic.ID, d) for d in (b"\x03", b"\x04"))
    air.gone(None)
    assert heard.get(timeout=60) == b""
    assert port.failure == "the port toio-M0p of the cube is gone: disconnected"
    with pytest.raises(AbortError, match="disconnected"):
        port.write(pack(Characteristic.MOTOR, MOTOR))
    port.close()
    assert air.written.get(timeout=60) == "disconnected"


@pytest.mark.parametrize(
    "air, why",
    [(Air("toio-C3P"), "was not found within"), (Air("toio-M0p", breaks=True), "no adapter")],
)
def test_a_cube_that_cannot_be_connected_is_one_line(connect, air, why):
    port, _ = connect(air)
    with pytest.raises(AbortError, match=why):
        port.open()


def test_cubes_are_known_by_name_letters_or_address():
    for name in ("toio-M0p", "toio Core Cube-M0p", "toio-M0p (toio Core Cube)"):
        assert is_cube("toio-M0p", name, "x") and is_cube("M0p", name, "x")
        assert not is_cube("toio-m0p", name, "x") and not is_cube("0p", name, "x")
    assert is_cube("C0:FF:EE:00:00:01", None, "c0:ff:ee:00:00:01")
