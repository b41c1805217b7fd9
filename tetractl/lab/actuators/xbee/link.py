"""The connection to the XBee radio module of this computer, with a check of the module."""

from collections import deque
from collections.abc import Callable

from tetractl.core.clock import Clock, wait_for
from tetractl.core.errors import AbortError
from tetractl.lab.actuators.xbee import api_frames as frames
from tetractl.lab.actuators.xbee.hardware import (
    BAUD_RATES,
    ESCAPED_API_MODE,
    REQUIRED_PROTOCOL,
    SERIES_1_CODES,
    XbeeSection,
    find_protocol,
    find_protocols,
)
from tetractl.lab.serial_port import PortFactory, SerialPort
from tetractl.tools.worker import QUEUE_MAX, take_all

MODULE_LOST_HINT = (
    "the robots stop by their watchdog; plug the module in again, and restart the run"
)


class XbeeLink:
    """A connection to the XBee radio module of this computer.

    After a failure, which raises AbortError, nothing can be sent any more.

    Args:
        radio: The fields of the radio in the spec.
        clock: The clock for times [ns].
        ports: Creates the serial port. None for `SerialPort`.

    Attributes:
        questions: Questions about the module, which the operator has to confirm.
    """

    def __init__(self, radio: XbeeSection, clock: Clock, ports: PortFactory | None = None) -> None:
        self.radio = radio
        self.questions: tuple[str, ...] = ()
        self._decoder = frames.Decoder()
        self._received_data: deque[bytes] = deque(maxlen=QUEUE_MAX)
        self._answers: dict[tuple[int, bytes], bytes | None] = {}
        """Answers since the last request, by its number and two letters. None for an error."""
        self._frame_id = 0
        self._clock = clock
        create_port = ports or SerialPort
        self._port = create_port(
            radio.port, radio.baud, "the radio", clock, self._process_bytes, MODULE_LOST_HINT
        )

    @property
    def failure(self) -> str | None:
        """Why nothing can be sent any more. None if there is no fault."""
        return self._port.failure

    def open(self, checked: bool = True, exclusive: bool = True) -> None:
        """Open the port, and check the radio module.

        Args:
            checked: Whether to check the module. This sets `questions` for the operator.
            exclusive: Whether to lock the port, so that no other process can open it.

        Raises:
            AbortError: If the port cannot be opened, or the module is unsuitable.
        """
        self._port.open(exclusive)
        if checked:
            self.questions = self._check()

    def send(self, data: bytes) -> int:
        """Broadcast data to all modules, and return the time of writing [ns].

        Raises AbortError if the port has failed.
        """
        return self._port.write(frames.encode(frames.BROADCAST + data))

    def request(self, command: bytes) -> bytes | None:
        """Request a parameter of the module, named by two letters, and return its value.

        The result is None if the module does not return a value within 0.3 s.
        """
        self._frame_id = self._frame_id % 255 + 1
        self._answers.clear()
        content = bytes((frames.AT_COMMAND, self._frame_id)) + command
        self._port.write(frames.encode(content))
        awaited = self._frame_id, command
        # a module at 9600 baud answers within 30 ms
        self._wait(lambda: awaited in self._answers, 0.3)
        return self._answers.get(awaited)

    def request_twice(self, command: bytes) -> bytes | None:
        """Request a parameter of the module. If no value is returned, repeat the request once.

        The result is None if no value is returned either time.
        """
        return self.request(command) or self.request(command)

    def fetch(self) -> list[bytes]:
        """Return the data received from other modules since the last call."""
        return take_all(self._received_data)

    def wait(self, timeout_s: float) -> None:
        """Wait until data from other modules can be fetched, for at most `timeout_s` seconds."""
        self._wait(lambda: bool(self._received_data), timeout_s)

    def close(self) -> None:
        """End the reading thread and release the port.

        This method can be called twice, and never raises.
        """
        self._port.close()

    def _wait(self, is_done: Callable[[], bool], timeout_s: float) -> None:
        """Wait until a condition holds or the port has failed, for at most `timeout_s` seconds."""
        wait_for(self._clock, lambda: is_done() or self.failure is not None, timeout_s)

    def _process_bytes(self, data: bytes, now: int) -> None:
        """Decode received bytes: store the module's answers, and the data from other modules."""
        for content in self._decoder.feed(data):
            if (answer := frames.answered(content)) is not None:
                frame_id, command, value = answer
                self._answers[frame_id, command] = value
            elif sent := frames.received(content):
                self._received_data.append(sent)

    def _check(self) -> tuple[str, ...]:
        """Raise AbortError unless a suitable radio module answers.

        A suitable module has 802.15.4 firmware, AP=2 and the spec's baud rate. If its protocol is
        not known, the result contains a question for the operator. A missing answer to HV or AP
        means that the module is refused, so these are requested twice. VR and BD are requested
        once.
        """
        radio = self.radio
        hardware = self._request_hardware()
        questions = self._check_firmware(hardware)
        baud_index_bytes = self.request(b"BD")
        baud_index = None if baud_index_bytes is None else int.from_bytes(baud_index_bytes)
        if (
            baud_index is not None
            and baud_index < len(BAUD_RATES)
            and BAUD_RATES[baud_index] != radio.baud
        ):
            raise AbortError(
                f"{radio.port}: the module is set to {BAUD_RATES[baud_index]} baud, but the spec "
                f"says {radio.baud}",
                f"set lab.actuator.baud to {BAUD_RATES[baud_index]}, or change BD in the module",
            )
        api_mode = self.request_twice(b"AP")
        if api_mode is None:
            raise AbortError(
                f"{radio.port}: the radio's module does not answer any more",
                "does the module have power, and is its plug firm?",
            )
        if int.from_bytes(api_mode) != ESCAPED_API_MODE:
            raise AbortError(
                f"{radio.port}: the XBee module is not in API mode with escapes (AP=2)",
                "set the module's parameter AP to 2, with Digi's program XCTU",
            )
        if radio.baud == 115_200 and hardware and hardware[0] in SERIES_1_CODES:
            raise AbortError(
                f"{radio.port}: this is a Series 1 module, which loses API frames at 115200 baud",
                "set the baud rate to 57600: in the module with BD=6, and in the spec with "
                "lab.actuator.baud",
            )
        return questions

    def _request_hardware(self) -> bytes:
        """Request the hardware version of the module, HV.

        Raises:
            AbortError: If the module is silent. The error gives the baud rate at which it does
                answer.
        """
        radio = self.radio
        # the first request may be lost behind an incomplete frame
        hardware = self.request_twice(b"HV")
        if hardware is not None:
            return hardware
        error = AbortError(
            f"{radio.port}: no XBee module answers at {radio.baud} baud or any other baud rate",
            "is the device an XBee, does it have power, and is it in API mode (AP=2)?",
        )
        for baud in BAUD_RATES[3:]:  # those that a spec may state, first a module's usual one
            if baud == radio.baud:
                continue
            self._port.set_baud(baud)
            if self.request(b"HV") is not None:
                error = AbortError(
                    f"{radio.port}: the module answers at {baud} baud, but the spec says "
                    f"{radio.baud}",
                    f"set lab.actuator.baud to {baud}, or change BD in the module",
                )
                break
        # a module that wakes late answers all requests at once, also those at another baud rate
        self._port.set_baud(radio.baud)
        hardware = self.request(b"HV")
        if hardware is None:
            raise error
        return hardware

    def _check_firmware(self, hardware: bytes) -> tuple[str, ...]:
        """Raise AbortError if the module has unsuitable firmware.

        Returns:
            A question for the operator if the firmware is unknown. Empty otherwise.
        """
        port = self.radio.port
        version = self.request(b"VR") or b""
        protocol = find_protocol(hardware, version)
        if protocol == REQUIRED_PROTOCOL:
            return ()
        if protocol is None:
            reported = version.hex().upper() or "not reported"
            module = f"the module (HV {hardware.hex().upper()}, VR {reported})"
            question = f"is not in tetractl's list: does it run {REQUIRED_PROTOCOL} firmware?"
            return (f"{port}: {module} {question}",)
        remedy = f"use a module that has {REQUIRED_PROTOCOL} firmware: Series 1, S2C, XBee 3 or RR"
        if REQUIRED_PROTOCOL in find_protocols(hardware).values():
            remedy = f"load {REQUIRED_PROTOCOL} firmware into the module with the program XCTU"
        raise AbortError(
            f"{port}: the module runs {protocol} firmware, but {REQUIRED_PROTOCOL} firmware is "
            "needed",
            f"the firmware of this module cannot broadcast wheel commands fast enough; {remedy}",
        )
