"""The spec of a lab with two robots, OptiTrack cameras and a radio."""

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
