"""What a robot on two wheels does with lines of text: commands in, wheel speeds and replies out.

The same as twist_core.c, whose header describes lines, flags, sequence, watchdog and emergency
stop. It runs on MicroPython and on Python; it has no I/O and no clock. Times are milliseconds and
may wrap round at 2^30, as MicroPython's do. Both pass tests/twist_vectors.txt.
"""

# flags of a command
RUN = 1
EMERGENCY_STOP = 2
POLL = 4
# status of a robot
RUNNING = 1
EMERGENCY_STOPPED = 2
SILENT = 4
ROBOTS_MAX = 32
LINE_MAX = 300
AHEAD_MAX = 127
WATCHDOG_MS = 250
FORGET_MS = 1000  # then any sequence is new
REPLY_SLOT_MS = 20
SPEED_MAX = 5000  # mm/s
TURN_MAX = 50000  # mrad/s
PERIOD = 1 << 30  # of the times


def crc16(data):
    """Return CRC-16/CCITT-FALSE of bytes."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1) ^ 0x1021 if crc & 0x8000 else crc << 1
        crc &= 0xFFFF
    return crc


def number(word, least, greatest):
    """Parse a decimal number of at most 6 digits from `least` to `greatest`.

    Any other text raises ValueError.
    """
    digits = word[1:] if word[:1] == b"-" else word
    if not 0 < len(digits) <= 6 or not digits.isdigit():
        raise ValueError
    value = int(word)
    if not least <= value <= greatest:
        raise ValueError
    return value


class Twist:
    """Robot number `index`, whose wheels are `radius_mm` from its centre; at power-up it stands."""

    def __init__(self, index, radius_mm):
        self.index = index
        self.radius_mm = radius_mm
        self.left = self.right = 0  # mm/s
        self.running = self.emergency_stopped = False
        self.silent = True
        self.known = self.forgotten = False  # of the sequence
        self.battery_mv = self.received = self.rejected = 0
        self.sequence = self.heard_ms = 0
        self.pending = None  # sequence and time of the reply to send
        self.line = bytearray()
        self.overlong = False

    def push(self, data, now_ms):
        """Take bytes from the radio."""
        self.watch(now_ms)
        for byte in data:
            if byte != 10:
                if len(self.line) < LINE_MAX:
                    self.line.append(byte)
                else:
                    self.overlong = True
                continue
            line = bytes(self.line)
            overlong = self.overlong
            self.line = bytearray()
            self.overlong = False
            self.read(line[:-1] if line[-1:] == b"\r" else line, overlong, now_ms)

    def read(self, line, overlong, now_ms):
        """Take a line, without its end; `overlong` if it was longer than LINE_MAX."""
        if not line and not overlong:
            return
        head = line[:-5]
        tail = line[-5:]
        if overlong or not head or tail != b"*%04X" % crc16(head):
            self.rejected += 1
        elif head[:1] in (b"T", b"W"):
            try:
                self.obey(*self.command(head), now_ms)
            except ValueError:
                self.rejected += 1

    def command(self, head):
        """Return sequence, flags and this robot's wheel speeds, None if it is not named."""
        words = head.split(b" ")
        if len(words) % 3 or len(words[0]) != 1:
            raise ValueError
        sequence = number(words[1], 0, 255)
        flags = number(words[2], 0, 7)
        wheels = words[0] == b"W"
        speeds = None
        for i in range(3, len(words), 3):
            index = number(words[i], 0, ROBOTS_MAX - 1)
            one = number(words[i + 1], -SPEED_MAX, SPEED_MAX)
            most = SPEED_MAX if wheels else TURN_MAX
            two = number(words[i + 2], -most, most)
            if index == self.index and speeds is None:
                rim = (abs(two) * self.radius_mm + 500) // 1000 * (-1 if two < 0 else 1)
                speeds = (one, two) if wheels else (one - rim, one + rim)
        return sequence, flags, speeds

    def obey(self, sequence, flags, speeds, now_ms):
        """Do what a command says."""
        is_next = self.known and 1 <= (sequence - self.sequence) % 256 <= AHEAD_MAX
        is_new = self.forgotten or is_next
        self.received += 1
        if flags & EMERGENCY_STOP:
            self.emergency_stopped = True
        if not flags & RUN or self.emergency_stopped:
            self.stop()
        elif is_new:
            self.left, self.right = speeds or (0, 0)
            self.running = speeds is not None
        if is_new:
            self.sequence = sequence
            self.heard_ms = now_ms
            self.silent = self.forgotten = False
            self.known = True
        if flags & POLL and (is_new or not flags & RUN):
            self.pending = sequence, now_ms + self.index * REPLY_SLOT_MS

    def stop(self):
        """Stand."""
        self.left = self.right = 0
        self.running = False

    def watch(self, now_ms):
        """Once silent it stays so until a new command comes, also when the clock wraps round."""
        quiet_ms = (now_ms - self.heard_ms) % PERIOD
        self.silent = self.silent or quiet_ms >= WATCHDOG_MS
        self.forgotten = self.forgotten or quiet_ms >= FORGET_MS
        if self.silent:
            self.stop()

    def wheels(self, now_ms):
        """Return the speeds [mm/s] to drive the wheels with now; call it every few milliseconds."""
        self.watch(now_ms)
        return self.left, self.right

    def status(self, now_ms):
        """Return the status flags."""
        self.watch(now_ms)
        bits = (self.running, RUNNING), (self.emergency_stopped, EMERGENCY_STOPPED)
        return sum(bit for on, bit in bits if on) + SILENT * self.silent

    def take_reply(self, now_ms):
        """Return the reply that is due now, b"" if there is none."""
        if self.pending is None or (now_ms - self.pending[1]) % PERIOD >= PERIOD // 2:
            return b""
        sequence = self.pending[0]
        self.pending = None
        head = b"S %d %d %d" % (self.index, sequence, self.status(now_ms))
        counts = self.battery_mv, self.received % 65536, self.rejected % 65536
        head += b" %d %d %d" % counts
        return head + b"*%04X\n" % crc16(head)
