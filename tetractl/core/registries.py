"""All registries: the names by which a spec finds optimisers, cameras, figures and so on.

A new kind needs a file, and a line in this module or an entry point; docs/how-to/extend.md
describes both. Kinds are strings of the form "module:attribute", so that `core` does not import
packages above it.
"""

from tetractl.core.registry import Registry

SECTION = "tetractl.spec.base:Model"

OPTIMIZERS = Registry(
    "tetractl.optimizers",
    {
        "pso": "tetractl.control.search.optimizers.pso:Pso",
        "multistart": "tetractl.control.search.optimizers.multistart:Multistart",
    },
    SECTION,
)
CONTROLLERS = Registry(
    "tetractl.controllers",
    {
        "mpc": "tetractl.control.methods.mpc_section:RecommendedMpc",
        "pso-mpc": "tetractl.control.methods.algorithm2_section:PsoMpc",
        "sequence": "tetractl.control.methods.sequence:SequenceSection",
    },
    "tetractl.spec.controller:ControllerSection",
)
MOTIONS = Registry(
    "tetractl.motions",
    {
        "euler": "tetractl.model.motion.euler:EULER",
        "exact": "tetractl.model.motion.exact:EXACT",
    },
)
SHAPES = Registry(
    "tetractl.shapes",
    {
        "rectangle": "tetractl.model.shapes:Rectangle",
        "circle": "tetractl.model.shapes:Circle",
        "polygon": "tetractl.model.shapes:Polygon",
    },
    SECTION,
)
PLANTS = Registry(
    "tetractl.plants",
    {
        "sim": "tetractl.plant.sim_section:SimSection",
        "lab": "tetractl.plant.lab_plant:LabPlantSection",
    },
    "tetractl.spec.plant:PlantSection",
)
CAMERAS = Registry(
    "tetractl.cameras",
    {
        "optitrack": "tetractl.lab.cameras.optitrack.section:OptitrackSection",
    },
    "tetractl.spec.lab_section:CameraSection",
)
ACTUATORS = Registry(
    "tetractl.actuators",
    {
        "m3pi-xbee": "tetractl.lab.actuators.m3pi.section:M3piSection",
        "twist": "tetractl.lab.actuators.twist.section:TwistSection",
    },
    "tetractl.spec.lab_section:ActuatorSection",
)
DISTURBANCES = Registry(
    "tetractl.disturbances",
    {
        "battery": "tetractl.plant.disturbances.robots:BatterySection",
        "camera-latency": "tetractl.plant.disturbances.camera:CameraLatencySection",
        "flow": "tetractl.plant.disturbances.swimmers:FlowSection",
        "frame-loss": "tetractl.plant.disturbances.camera:FrameLossSection",
        "frozen-camera": "tetractl.plant.disturbances.camera:FrozenCameraSection",
        "heading-drift": "tetractl.plant.disturbances.robots:HeadingDriftSection",
        "marker-off": "tetractl.plant.disturbances.camera:MarkerOffSection",
        "planning-time": "tetractl.plant.disturbances.radio:PlanningTimeSection",
        "radio": "tetractl.plant.disturbances.radio:RadioSection",
        "silent-radio": "tetractl.plant.disturbances.radio:SilentRadioSection",
        "stale-camera": "tetractl.plant.disturbances.camera:StaleCameraSection",
        "start-error": "tetractl.plant.disturbances.robots:StartErrorSection",
        "sticking": "tetractl.plant.disturbances.robots:StickingSection",
        "tracking-loss": "tetractl.plant.disturbances.camera:TrackingLossSection",
        "wander": "tetractl.plant.disturbances.robots:WanderSection",
        "wobble": "tetractl.plant.disturbances.swimmers:WobbleSection",
    },
    "tetractl.spec.disturbance:DisturbanceSection",
)
TRIAL_ROBOTS = Registry("tetractl.trial_robots", {}, "tetractl.spec.trial_robots:TrialRobots")
SPEC_REGISTRIES = (
    OPTIMIZERS,
    CONTROLLERS,
    MOTIONS,
    SHAPES,
    PLANTS,
    DISTURBANCES,
    CAMERAS,
    ACTUATORS,
    TRIAL_ROBOTS,
)
"""The registries of the kinds that a spec can name."""

SWEEPS = Registry(
    "tetractl.sweeps",
    {
        "grid": "tetractl.study.sweep:Grid",
        "list": "tetractl.study.sweep:Points",
        "random": "tetractl.study.sweep:Random",
        "sobol": "tetractl.study.sweep:Sobol",
    },
    "tetractl.study.sweep:Sweep",
)
STATISTICS = Registry(  # in the order in which tables show them
    "tetractl.statistics",
    {
        "outcomes": "tetractl.statistics.built_in_statistics:OUTCOMES",
        "arrived": "tetractl.statistics.built_in_statistics:ARRIVED",
        "obstacle_violations": "tetractl.statistics.built_in_statistics:OBSTACLE_VIOLATIONS",
        "left_arena": "tetractl.statistics.built_in_statistics:LEFT_ARENA",
        "bodies_touch": "tetractl.statistics.built_in_statistics:TOUCHED",
        "clearance": "tetractl.statistics.built_in_statistics:CLEARANCE",
        "edge": "tetractl.statistics.built_in_statistics:EDGE",
        "apart": "tetractl.statistics.built_in_statistics:APART",
        "way_points": "tetractl.statistics.built_in_statistics:WAY_POINTS",
        "time_inside": "tetractl.statistics.built_in_statistics:TIME_INSIDE",
        "disc": "tetractl.statistics.built_in_statistics:DISC",
        "lost": "tetractl.statistics.built_in_statistics:LOST",
        "wheel_lag": "tetractl.statistics.built_in_statistics:WHEEL_LAG",
        "turn": "tetractl.statistics.built_in_statistics:TURN",
        "recovered": "tetractl.statistics.built_in_statistics:RECOVERED",
        "solve_ms": "tetractl.statistics.built_in_statistics:SOLVE_MS",
        "deadline_misses": "tetractl.statistics.built_in_statistics:DEADLINE_MISSES",
    },
)
FIGURES = Registry(
    "tetractl.figures",
    {
        "trajectory": "tetractl.view.figures.trajectory:trajectory_figure",
        "convergence": "tetractl.view.figures.convergence:convergence_figure",
        "errors": "tetractl.view.figures.errors:errors_figure",
        "batch": "tetractl.view.figures.batch:figure_of_logs",
        "over-time": "tetractl.view.figures.over_time:over_time_figure",
    },
)
REGISTRIES = (*SPEC_REGISTRIES, SWEEPS, STATISTICS, FIGURES)

COMMANDS = Registry(
    "tetractl.commands",
    {
        "init": "tetractl.cli.specs:init",
        "run": "tetractl.cli.run:run",
        "play": "tetractl.cli.play:play",
        "replay": "tetractl.cli.replay:replay",
        "stats": "tetractl.cli.stats:stats",
        "validate": "tetractl.cli.specs:validate",
        "rerun": "tetractl.cli.rerun:rerun",
        "study": "tetractl.cli.study:study",
        "analyze": "tetractl.cli.analyze:analyze",
        "warm": "tetractl.cli.specs:warm",
        "plot": "tetractl.cli.plot:plot",
        "report": "tetractl.cli.report:report",
        "open": "tetractl.cli.report:open_",
        "export": "tetractl.cli.export:export",
        "info": "tetractl.cli.info:info",
        "verify": "tetractl.cli.verify:verify",
        "recover": "tetractl.cli.verify:recover",
        "schema": "tetractl.cli.specs:schema",
        "kinds": "tetractl.cli.kinds:kinds",
    },
)
LAB_COMMANDS = Registry(
    "tetractl.lab_commands",
    {
        "check": "tetractl.cli.lab:check",
        "stop": "tetractl.cli.lab:stop",
        "calibrate": "tetractl.cli.lab:calibrate",
        "guard": "tetractl.cli.lab_guard:guard",
        "bundle": "tetractl.cli.lab_bundle:bundle",
    },
)
"""The commands, and the subcommands of `tetractl lab`, in the order of the help."""
KIND_CHECKS = Registry("tetractl.kind_checks", {})
"""What `tetractl kinds --check` calls: the function `kind`, which tetractl-testing provides."""
EXAMPLES = Registry("tetractl.examples", {})
"""Folders of further example specs.

Each is a `Path`, named after the package that provides it.
"""
TEMPLATES = Registry("tetractl.templates", {})
"""Folders with further parts for the specs that `init --lab` writes. Each is a `Path`."""


def all_registries() -> list[Registry]:
    """Return all registries of kinds, including those that other packages declare.

    A registry of another package is left out if it cannot be loaded.
    """
    return [*REGISTRIES, *Registry("tetractl.registries", {}).load_usable().values()]
