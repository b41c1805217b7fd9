"""Specs of two robots in a lab, by its camera and actuator."""

SPEC = """
name: emulated
units: {length: mm}
arena: {left: 0, bottom: 0, width: 2000, height: 2000}
robots:
  - {name: green, start: [500, 500], heading: 0.5, target: [1500, 500], a: 6, speed: 180}
  - {name: blue, start: [500, 1500], heading: -2, target: [1500, 1500], a: 4, speed: 200}
wheels: {radius: 40}
lab:
  camera:
    type: optitrack
    server: 127.0.0.1
    transport: unicast
    robots: [{name: green, body: Green}, {name: blue, body: 7}]
  actuator:
    type: m3pi-xbee
    port: nowhere
    robots: [{name: green, index: 0}, {name: blue, index: 1}]
"""
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
