"""Specs to start from, as `tetractl init` writes them."""

from tetractl.experiment.yaml.core_yaml import dump

HEAD = """\
# {title}
#
#   tetractl validate {file}   checks it
#   tetractl run {file}        runs it; --set PATH=VALUE changes a value for one run
#
# Every field and its default is in docs/reference/spec.md. For completion in editors, write
# `tetractl schema -o experiment.schema.json` and put this on top of the file:
# yaml-language-server: $schema=experiment.schema.json

{name}
units: {{length: {unit}}}   # of every position, speed and error; times are seconds, angles radians
"""

M3PI = """
# The field of view. Starts, targets and obstacles lie in it.
arena: {left: 0, bottom: 0, width: 1600, height: 1600}

# All robots get one direction. Each turns towards it at a * sin(direction - heading) and drives on
# at its speed. Only because they differ in a can they be brought to different targets.
robots:
  - {name: green, start: [300, 400], heading: 0, target: [1300, 500], a: 6, speed: 180}
  - {name: blue, start: [300, 800], heading: 0, target: [1200, 1150], a: 3.5, speed: 200}

obstacles:
  - {type: rectangle, left: 700, bottom: 550, width: 150, height: 200}
# - {type: circle, center: [900, 1200], radius: 80}

wheels: {radius: 40}    # from a wheel to the robot's centre; its wheel speeds are logged
"""

CELLS = """
# The field of view of the microscope. Starts, targets and obstacles lie in it.
arena: {left: 0, bottom: 0, width: 5000, height: 5000}

# All cells feel one field direction. Each turns towards it at a * sin(direction - heading) and
# swims on at its speed. Only because they differ in a can they be brought to different targets.
robots:
  - {name: first, start: [1000, 1500], heading: 0, target: [3200, 1200], a: 5, speed: 300}
  - {name: second, start: [1000, 3000], heading: 0, target: [3300, 3400], a: 3, speed: 330}

obstacles:
  - {type: circle, center: [2250, 2150], radius: 250}
# - {type: rectangle, left: 3000, bottom: 4000, width: 300, height: 200}
"""

CONTROLLER = """
controller:
  type: mpc
  period: 0.2             # s: a new direction five times a second
  motion: exact           # predict by the closed form of the motion
  estimate: true          # learn each robot's a and speed on the way
  horizon_max: 51         # signals: the longest plan is 10.2 s
  steps_max: 100          # control steps of a trial at most
  arrival_tolerance: {tolerance}   # {unit}; a trial ends when every robot is this near its target
  accept: {tolerance}              # {unit}, all together: with more, the robots go round
  collision: {{check: swept, margin: {margin}, walls: true}}   # {unit} kept from obstacles and edge
  optimizer: {{type: multistart}}   # the optimiser; pso is the paper's
"""

LAB_CONTROLLER = """
controller:
  type: mpc
  period: 0.05            # s: control at 20 Hz ...
  hold: 4                 # ... of a plan whose directions are held for 0.2 s
  motion: exact           # predict by the closed form of the motion
  estimate: true          # learn each robot's a and speed on the way
  dead_time: 0.06         # s: cameras (`tetractl lab check` measures), radio, the wheels' lag
  horizon_max: 51         # signals: the longest plan is 10.2 s
  steps_max: 400          # control steps of a trial at most
  arrival_tolerance: {tolerance}   # {unit}; a trial ends when every robot is this near its target
  accept: {tolerance}              # {unit}, all together: with more, the robots go round
  collision: {{check: swept, margin: {margin}, walls: true}}   # {unit} kept from obstacles and edge
  deadline: 0.035         # s: a control step has to end before the next
  optimizer: {{type: multistart}}   # the optimiser; pso is the paper's
"""

M3PI_PLANT = """
# A simulation, undisturbed. Try dead_time, lost_commands, a_error, speed_error, heading_noise.
plant: {type: sim}
"""

CELLS_PLANT = """
# A simulation of cells that wander, are seen with some error, and are not known exactly.
plant:
  type: sim
  camera_rate: 30         # Hz
  measurement_noise: {position: 5, heading: 0.05}
  heading_noise: 0.05     # rad/sqrt(s)
  a_error: 0.1            # true a within 10 % of the one above
  speed_error: 0.1
"""

LAB = """
# Without --plant: a simulation with the lab's dead time.
plant: {type: sim, dead_time: 0.06}

# With --plant lab: what differs between two labs. Try it first with `tetractl lab emulate`.
lab:
  camera:
    type: optitrack
    server: 192.168.1.10        # the computer that runs Motive
    interface: 192.168.1.20     # this computer's network card on that network
    transport: multicast        # as in Motive's streaming settings
    robots:                     # body: a robot's name in Motive
      - {name: green, body: green}
      - {name: blue, body: blue}
  actuator:
    type: m3pi-xbee
    port: /dev/ttyUSB0
    baud: 57600
    protocol: {type: broadcast}   # robots with the mbed firmware, which has a watchdog
    robots:                       # index: as each robot's firmware was built with
      - {name: green, index: 0}
      - {name: blue, index: 1}
  # Gains, dead zones, swaps and offsets come from `tetractl lab calibrate`:
  # calibration: m3pi.calibration.yaml
"""

TRIALS = """
trials: {count: 5, seed: 1}   # how often, and where all chance comes from
"""


def template(name: str, file: str, cells: bool = False, lab: bool = False) -> str:
    """Return a commented spec of an experiment called `name`, to be kept in `file`.

    It steers two robots (mm), with `cells` two cells (um); with `lab` it has the lab of the robots.
    """
    unit, tolerance, margin = ("um", 50, 25) if cells else ("mm", 20, 50 if lab else 20)
    title = "Two cells steered by one field." if cells else "Two robots steered by one signal."
    control = LAB_CONTROLLER if lab else CONTROLLER
    named = dump({"name": name}).strip("{}\n")  # in quotes where the name reads as a number
    return "".join(
        (
            HEAD.format(title=title, file=file, name=named, unit=unit),
            CELLS if cells else M3PI,
            control.format(tolerance=tolerance, margin=margin, unit=unit),
            LAB if lab else CELLS_PLANT if cells else M3PI_PLANT,
            TRIALS,
        )
    )
