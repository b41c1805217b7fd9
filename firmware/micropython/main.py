"""A Pololu 3pi+ 2040 that drives as tetractl says: copy twist.py and this file to the robot.

NOT TRIED ON HARDWARE. twist.py decides everything; here are only wiring and wheel speeds: a radio
module, transparent at 57600 baud, on UART 0 (TX GP28, RX GP29), and Pololu's library for motors,
encoders and battery. Set INDEX to the robot's place in the spec, from 0.
"""

from time import sleep_ms, ticks_diff, ticks_ms

from machine import UART, WDT, WDT_RESET, Pin, reset_cause
from pololu_3pi_2040_robot import robot
from twist import Twist

INDEX = 0
RADIUS_MM = 43  # guess: half of the distance between the wheels' middles; measure yours
COUNTS_A_MM = 3.57  # guess: 12 counts, gears 29.86:1, wheels of 32 mm; the Standard Edition
DUTY_A_MM_S = 4.0  # guess: of 6000, for a speed of 1 mm/s; the integral finds the rest
GAIN = 4.0  # duty for an error of 1 mm/s
INTEGRAL = 20.0  # duty for an error of 1 mm
PERIOD_MS = 10  # of the control of the wheels' speeds
LOW_MV = 4000  # below this voltage motors fail: the robot stops


class Wheel:
    """The speed of one wheel, held by its encoder."""

    def __init__(self):
        self.counts = 0
        self.owed_mm = 0.0

    def duty(self, wished_mm_s, counts, seconds):
        """Return the duty for a speed, given the encoder's counts now."""
        driven_mm = (counts - self.counts) / COUNTS_A_MM
        self.counts = counts
        if wished_mm_s == 0:
            self.owed_mm = 0.0
            return 0
        self.owed_mm += wished_mm_s * seconds - driven_mm
        self.owed_mm = min(max(self.owed_mm, -50.0), 50.0)
        error = wished_mm_s - driven_mm / seconds
        return round(DUTY_A_MM_S * wished_mm_s + GAIN * error + INTEGRAL * self.owed_mm)


def main():
    """Drive until the robot is switched off."""
    radio = UART(0, baudrate=57600, tx=Pin(28), rx=Pin(29), rxbuf=512)
    motors = robot.Motors()
    encoders = robot.Encoders()
    battery = robot.Battery()
    left = Wheel()
    right = Wheel()
    twist = Twist(INDEX, RADIUS_MM)
    dog = WDT(timeout=250)  # if this loop stops, the processor restarts, and the motors are off
    driven_ms = measured_ms = ticks_ms()
    twist.battery_mv = battery.get_level_millivolts()
    twist.emergency_stopped = reset_cause() == WDT_RESET  # until it is switched off and on
    while True:
        now_ms = ticks_ms()
        if radio.any():
            twist.push(radio.read(), now_ms)
        if ticks_diff(now_ms, measured_ms) >= 1000:
            measured_ms = now_ms
            twist.battery_mv = battery.get_level_millivolts()
        since_ms = ticks_diff(now_ms, driven_ms)
        wished = twist.wheels(now_ms)
        if since_ms >= PERIOD_MS or wished == (0, 0):
            if 0 < twist.battery_mv < LOW_MV:
                wished = 0, 0
            counts = encoders.get_counts()
            seconds = max(since_ms, 1) / 1000
            motors.set_speeds(
                left.duty(wished[0], counts[0], seconds), right.duty(wished[1], counts[1], seconds)
            )
            driven_ms = now_ms
        reply = twist.take_reply(now_ms)
        if reply:
            radio.write(reply)
        dog.feed()
        sleep_ms(1)


main()
