"""What is between the serial port and the robots: UARTs, the air, loss and acknowledgements.

A frame costs its bytes on the PC's UART, 32 us a byte on the air after a short random wait, and
its bytes on the robot's UART. Broadcasts are not acknowledged; a unicast is tried four times.
"""

import random
from collections.abc import Callable, Sequence

from tetractl.core.clock import SECOND
from tetractl.emulate.loop import Timeline
from tetractl.emulate.m3pi.module import Delivery, Done, EmulatedModule, ModuleSettings
from tetractl.emulate.m3pi.robot import EmulatedRobot
from tetractl.emulate.port import PseudoPort
from tetractl.lab.actuators.xbee.frames import BROADCAST_16

AIR_NS_A_BYTE = 32_000
AIR_OVERHEAD = 17  # bytes: preamble, header, checksum
BACKOFF_NS = 320_000  # the longest wait for a clear channel
ACK_NS = 860_000  # how long a sender waits for an acknowledgement
TRIES = 4
ROBOT_BAUD = 57600

Heard = Callable[[bytes], None]


class EmulatedRadio:
    """The PC's module on its port and one module a robot, at `addresses`.

    `on_wire` is called with every chunk of bytes as it is read from the port. `loss` is the
    probability that one robot does not hear one transmission.
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
        self.port = port
        self.loss = loss
        self.robots = dict(zip(addresses, robots, strict=True))
        self.garbled = 0  # chunks that came at another speed than the module's
        self._timeline = timeline
        self._settings = settings
        self._random = random.Random(seed)
        self._on_wire = on_wire
        self._on_heard = on_heard
        self._module = EmulatedModule(settings, self._transmit, self._to_pc)
        self._in_ns = self._out_ns = self._air_ns = 0  # when each of the three is free again

    def readable(self) -> None:
        """Take what the PC wrote; it reaches the module after its time on the UART."""
        data = self.port.read()
        if not data:
            return
        self._on_wire(data)
        if self.port.baud() != self._settings.baud:
            self.garbled += 1
            return
        start = max(self._timeline.now_ns, self._in_ns)
        self._in_ns = start + _uart_ns(len(data), self._settings.baud)
        self._timeline.at(self._in_ns, lambda: self._module.hear(data))

    def poll_answers(self) -> None:
        """Send what robots have to say; call it every millisecond or so."""
        for address, robot in self.robots.items():
            if answer := robot.answer():
                ready = self._timeline.now_ns + _uart_ns(len(answer), ROBOT_BAUD)
                self._timeline.at(ready, lambda a=address, d=answer: self._answer(a, d))

    def _to_pc(self, data: bytes) -> None:
        start = max(self._timeline.now_ns, self._out_ns)
        self._out_ns = start + _uart_ns(len(data), self._settings.baud)
        self._timeline.at(self._out_ns, lambda: self.port.write(data))

    def _take_air(self, size: int) -> int:
        """Return when a transmission of that size ends, once the air is free."""
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
            self._timeline.at(arrives, lambda: done(Delivery.SUCCESS))
            return
        robot = self.robots.get(destination)
        for _ in range(TRIES):
            arrives = self._take_air(len(payload))
            self._air_ns += ACK_NS
            if robot and robot.powered and self._random.random() >= self.loss:
                self._deliver(robot, payload, arrives)
                self._timeline.at(self._air_ns, lambda: done(Delivery.SUCCESS))
                return
        self._timeline.at(self._air_ns, lambda: done(Delivery.NO_ACK))

    def _deliver(self, robot: EmulatedRobot, payload: bytes, arrives: int) -> None:
        def hear() -> None:
            if robot.powered:
                robot.hear(payload)
                self._on_heard(robot, payload)

        self._timeline.at(arrives + _uart_ns(len(payload), ROBOT_BAUD), hear)

    def _answer(self, address: int, payload: bytes) -> None:
        for _ in range(TRIES):
            arrives = self._take_air(len(payload))
            self._air_ns += ACK_NS
            if self._random.random() >= self.loss:
                self._timeline.at(arrives, lambda: self._module.receive(address, payload))
                return


def _uart_ns(size: int, baud: int) -> int:
    return size * 10 * SECOND // baud
