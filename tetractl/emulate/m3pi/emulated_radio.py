"""The emulated radio: the XBee at the PC, UARTs, transmission, loss and acknowledgements; no I/O.

A frame takes time on the PC's UART, then, after a short random wait, 32 us per byte on the air,
then time on the robot's UART. Broadcasts are not acknowledged; a message to one robot is sent up to
four times, until it is acknowledged. The module answers AT commands that request a parameter, and
reports the result of each transmission. In transparent mode, bytes are sent without frames.
"""

import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from tetractl.emulate.loop import Timeline
from tetractl.emulate.m3pi.robot import EmulatedRobot
from tetractl.emulate.port import PseudoPort, SerialDevice, uart_ns
from tetractl.lab.actuators.xbee.frames import (
    BROADCAST_16,
    EXPLICIT_RECEIVE,
    AtCommand,
    AtResponse,
    Decoder,
    Other,
    Receive16,
    Transmit16,
    TransmitStatus,
    XbeeFrame,
    encode,
)
from tetractl.lab.actuators.xbee.hardware import BAUDS

RSSI = 40  # -dBm
PAYLOAD = 100  # largest 802.15.4 payload [bytes]
SERIAL = 0x0013A200_40000000  # a module's 64-bit address is this plus its 16-bit address


SUCCESS, NO_ACK = 0, 1  # results of a transmission, as in frame 0x89
Done = Callable[[int], None]
Send = Callable[[int, bytes, Done], None]  # 16-bit address, payload, callback for the result
Write = Callable[[bytes], None]


@dataclass(frozen=True, slots=True)
class ModuleSettings:
    """Settings of the module; `mode` is its parameter AP, `explicit` is whether its AO is 1."""

    baud: int = 57600
    mode: int = 2
    hardware: int = 0x1744  # HV: Series 1
    firmware: int = 0x10EC  # VR: 802.15.4
    explicit: bool = False


class EmulatedModule:
    """An XBee module; `send` transmits a payload by radio, `write` sends bytes to the PC."""

    def __init__(self, settings: ModuleSettings, send: Send, write: Write) -> None:
        self.settings = settings
        self._send = send
        self._write = write
        self._decoder = Decoder(escaped=settings.mode == 2)
        self._parameters = {
            b"HV": settings.hardware.to_bytes(2, "big"),
            b"VR": settings.firmware.to_bytes(2, "big"),
            b"BD": BAUDS.index(settings.baud).to_bytes(4, "big"),
            b"AP": bytes([settings.mode]),
        }

    def hear(self, data: bytes) -> None:
        """Take bytes from the PC that the module's UART has received."""
        if self.settings.mode:
            for frame in self._decoder.feed(data):
                self._obey(frame)
            return
        for start in range(0, len(data), PAYLOAD):
            self._send(BROADCAST_16, data[start : start + PAYLOAD], lambda delivery: None)

    def receive(self, source: int, payload: bytes) -> None:
        """Pass a payload received by radio from the address `source` on to the PC."""
        if not self.settings.mode:
            self._write(payload)
        elif self.settings.explicit:  # both addresses, endpoints, cluster, profile, options
            sender = (SERIAL + source).to_bytes(8, "big")
            head = sender + source.to_bytes(2, "big") + bytes.fromhex("E8E80011C10501")
            self._answer(Other(EXPLICIT_RECEIVE, head + payload))
        else:
            self._answer(Receive16(source, RSSI, 0, payload))

    def _answer(self, frame: XbeeFrame | Other) -> None:
        self._write(encode(frame, escaped=self.settings.mode == 2))

    def _obey(self, frame: XbeeFrame | Other) -> None:
        match frame:
            case AtCommand(frame_id, command, data):
                value = None if data else self._parameters.get(command)
                status = 2 if value is None else 0  # 2: an invalid command
                self._answer(AtResponse(frame_id, command, status, value or b""))
            case Transmit16(frame_id, destination, _, data):
                self._send(destination, data, self._status(frame_id))
            case _:
                pass  # a module does not answer unknown frames

    def _status(self, frame_id: int) -> Done:
        def done(delivery: int) -> None:
            if frame_id:
                self._answer(TransmitStatus(frame_id, delivery))

        return done


AIR_NS_A_BYTE = 32_000
AIR_OVERHEAD = 17  # bytes: preamble, header, checksum
BACKOFF_NS = 320_000  # longest random wait before a transmission
ACK_NS = 860_000  # time a sender waits for an acknowledgement
TRIES = 4
ROBOT_BAUD = 57600

Heard = Callable[[bytes], None]


class EmulatedRadio(SerialDevice):
    """The PC's module on its port, and one module per robot at `addresses`.

    `on_wire` is called with every chunk of bytes read from the port, `on_heard` with each robot
    that receives a payload and the payload. `loss` is the probability that a robot does not receive
    a transmission.
    """

    def __init__(
        self,
        timeline: Timeline,
        port: PseudoPort,
        settings: ModuleSettings,
        robots: Sequence[EmulatedRobot],
        addresses: Sequence[int],
        loss: float,
        seed: int,
        on_wire: Heard,
        on_heard: Callable[[EmulatedRobot, bytes], None],
    ) -> None:
        super().__init__(timeline, port, settings.baud)
        self.loss = loss
        self.robots = dict(zip(addresses, robots, strict=True))
        self._random = random.Random(seed)
        self._on_wire = on_wire
        self._on_heard = on_heard
        self._module = EmulatedModule(settings, self._transmit, self._answer)
        self._air_ns = 0  # when the air is free again

    def hear(self, data: bytes) -> None:
        """Take bytes that the module's UART has received from the PC."""
        self._module.hear(data)

    def _witness(self, data: bytes) -> None:
        self._on_wire(data)

    def poll_answers(self) -> None:
        """Send the answers that robots have ready; to be called about every millisecond."""
        for address, robot in self.robots.items():
            if answer := robot.answer():
                ready = self._timeline.now_ns + uart_ns(len(answer), ROBOT_BAUD)
                self._timeline.at(ready, lambda a=address, d=answer: self._reply(a, d))

    def _take_air(self, size: int) -> int:
        """Reserve the radio channel for a transmission of `size` bytes; return the time of its end
        [ns].
        """
        start = max(self._timeline.now_ns, self._air_ns)
        wait = round(self._random.uniform(0, BACKOFF_NS))
        self._air_ns = start + wait + (size + AIR_OVERHEAD) * AIR_NS_A_BYTE
        return self._air_ns

    def _transmit(self, destination: int, payload: bytes, done: Done) -> None:
        if destination == BROADCAST_16:
            arrives = self._take_air(len(payload))
            for robot in self.robots.values():
                if self._random.random() >= self.loss:
                    self._deliver(robot, payload, arrives)
            self._timeline.at(arrives, lambda: done(SUCCESS))
            return
        robot = self.robots.get(destination)
        for _ in range(TRIES):
            arrives = self._take_air(len(payload))
            self._air_ns += ACK_NS
            if robot and robot.powered and self._random.random() >= self.loss:
                self._deliver(robot, payload, arrives)
                self._timeline.at(self._air_ns, lambda: done(SUCCESS))
                return
        self._timeline.at(self._air_ns, lambda: done(NO_ACK))

    def _deliver(self, robot: EmulatedRobot, payload: bytes, arrives: int) -> None:
        def hear() -> None:
            if robot.powered:
                robot.hear(payload)
                self._on_heard(robot, payload)

        self._timeline.at(arrives + uart_ns(len(payload), ROBOT_BAUD), hear)

    def _reply(self, address: int, payload: bytes) -> None:
        for _ in range(TRIES):
            arrives = self._take_air(len(payload))
            self._air_ns += ACK_NS
            if self._random.random() >= self.loss:
                self._timeline.at(arrives, lambda: self._module.receive(address, payload))
                return
