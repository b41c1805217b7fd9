"""Specs of a lab with two robots and another actuator (a field or lines) or an AprilTag camera."""

from testkit.lab_specs import SPEC

FIELD = """
  actuator:
    type: field
    port: nowhere
    strength_mt: 2.0
    coils:
      x: {gain_mt_a: 2.1, offset_mt: 0.02}
      y: {gain_mt_a: -1.8, offset_mt: -0.04}
      rotation: 0.3
    current_max_a: 2.0
    slew_max_a_s: 100
"""
FIELD_SPEC = SPEC[: SPEC.index("  actuator:")].replace("wheels: {radius: 40}\n", "") + FIELD[1:]
TWIST_SPEC = (
    SPEC[: SPEC.index("  actuator:")]
    + """  actuator:
    type: twist
    port: udp://192.168.4.255:9750
    robots:
      - {name: green, right_gain: 1.05}
      - {name: blue, index: 4, port: radio}
"""
)
APRILTAG = """lab:
  camera:
    type: apriltag
    source: {type: mjpeg, url: 'http://127.0.0.1:8080/'}
    robots:
      - {name: green, tag: 1, size_mm: 100, height_mm: 60}
      - {name: blue, tag: 2, size_mm: 100, height_mm: 60, heading_offset: 0.5}
    floor:
      - {tag: 100, at: [0, 0], size_mm: 150}
      - {tag: 101, at: [2000, 0], size_mm: 150}
      - {tag: 102, at: [2000, 2000], size_mm: 150}
      - {tag: 103, at: [0, 2000], size_mm: 150}
"""
APRILTAG_SPEC = SPEC[: SPEC.index("lab:")] + APRILTAG + SPEC[SPEC.index("  actuator:") :]
