"""The device's end of a port in memory, for tests that play the device."""

from tetractl_emulator.memory_wires import MemoryPort


class HeardPort(MemoryPort):
    """Calls `hear` as soon as something is written to it, in place of at the next step."""

    def __init__(self, network, name, hear):
        super().__init__(network, name)
        self.hear = hear

    def take(self, data):
        super().take(data)
        self.hear()
