"""Runs the vectors of tests/twist_vectors.txt against twist.py, in MicroPython or Python."""

from twist import FORGET_MS, Twist


def unescape(text):
    """Return the bytes of a text with the escapes \\n, \\r and \\xHH."""
    out = bytearray()
    parts = text.split("\\")
    out.extend(parts[0].encode())
    for part in parts[1:]:
        if part[0] == "x":
            out.append(int(part[1:3], 16))
            out.extend(part[3:].encode())
        else:
            out.append(10 if part[0] == "n" else 13)
            out.extend(part[1:].encode())
    return bytes(out)


def run(text):
    """Return the number of checks, and a line for each that fails."""
    robot = None
    checks = 0
    failures = []
    for number, line in enumerate(text.split("\n"), 1):
        words = line.split(" ", 2)
        if line[:1] == "#" or len(words) < 2:
            continue
        what = words[0]
        first = int(words[1])
        rest = words[2] if len(words) > 2 else ""
        if what in ("init", "boot"):
            robot = Twist(first, int(rest))
            if what == "init":
                robot.watch(FORGET_MS)
            continue
        if what == "battery":
            robot.battery_mv = first
            continue
        if what == "push":
            robot.push(unescape(rest), first)
            continue
        checks += 1
        if what == "wheels":
            ok = robot.wheels(first) == tuple(int(word) for word in rest.split(" "))
        elif what == "status":
            ok = robot.status(first) == int(rest)
        else:
            ok = what == "reply" and robot.take_reply(first) == unescape(rest)
        if not ok:
            failures.append(f"line {number}: {line} is wrong")
    return checks, failures
