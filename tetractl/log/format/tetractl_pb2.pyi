from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from typing import ClassVar as _ClassVar, Iterable as _Iterable, Mapping as _Mapping, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class CameraFrames(_message.Message):
    __slots__ = ("times", "poses", "valid", "truth", "exact", "late")
    TIMES_FIELD_NUMBER: _ClassVar[int]
    POSES_FIELD_NUMBER: _ClassVar[int]
    VALID_FIELD_NUMBER: _ClassVar[int]
    TRUTH_FIELD_NUMBER: _ClassVar[int]
    EXACT_FIELD_NUMBER: _ClassVar[int]
    LATE_FIELD_NUMBER: _ClassVar[int]
    times: bytes
    poses: bytes
    valid: _containers.RepeatedScalarFieldContainer[bool]
    truth: bytes
    exact: bool
    late: bytes
    def __init__(self, times: _Optional[bytes] = ..., poses: _Optional[bytes] = ..., valid: _Optional[_Iterable[bool]] = ..., truth: _Optional[bytes] = ..., exact: bool = ..., late: _Optional[bytes] = ...) -> None: ...

class MocapSample(_message.Message):
    __slots__ = ("frame", "sampled_ns", "received_ns", "x", "y", "heading", "valid", "exposed_ns")
    FRAME_FIELD_NUMBER: _ClassVar[int]
    SAMPLED_NS_FIELD_NUMBER: _ClassVar[int]
    RECEIVED_NS_FIELD_NUMBER: _ClassVar[int]
    X_FIELD_NUMBER: _ClassVar[int]
    Y_FIELD_NUMBER: _ClassVar[int]
    HEADING_FIELD_NUMBER: _ClassVar[int]
    VALID_FIELD_NUMBER: _ClassVar[int]
    EXPOSED_NS_FIELD_NUMBER: _ClassVar[int]
    frame: int
    sampled_ns: int
    received_ns: int
    x: _containers.RepeatedScalarFieldContainer[float]
    y: _containers.RepeatedScalarFieldContainer[float]
    heading: _containers.RepeatedScalarFieldContainer[float]
    valid: _containers.RepeatedScalarFieldContainer[bool]
    exposed_ns: _containers.RepeatedScalarFieldContainer[int]
    def __init__(self, frame: _Optional[int] = ..., sampled_ns: _Optional[int] = ..., received_ns: _Optional[int] = ..., x: _Optional[_Iterable[float]] = ..., y: _Optional[_Iterable[float]] = ..., heading: _Optional[_Iterable[float]] = ..., valid: _Optional[_Iterable[bool]] = ..., exposed_ns: _Optional[_Iterable[int]] = ...) -> None: ...

class WheelCommand(_message.Message):
    __slots__ = ("direction", "stop", "sent_ns", "delivered", "left", "right", "lag", "facing")
    DIRECTION_FIELD_NUMBER: _ClassVar[int]
    STOP_FIELD_NUMBER: _ClassVar[int]
    SENT_NS_FIELD_NUMBER: _ClassVar[int]
    DELIVERED_FIELD_NUMBER: _ClassVar[int]
    LEFT_FIELD_NUMBER: _ClassVar[int]
    RIGHT_FIELD_NUMBER: _ClassVar[int]
    LAG_FIELD_NUMBER: _ClassVar[int]
    FACING_FIELD_NUMBER: _ClassVar[int]
    direction: float
    stop: bool
    sent_ns: int
    delivered: _containers.RepeatedScalarFieldContainer[bool]
    left: _containers.RepeatedScalarFieldContainer[float]
    right: _containers.RepeatedScalarFieldContainer[float]
    lag: float
    facing: float
    def __init__(self, direction: _Optional[float] = ..., stop: bool = ..., sent_ns: _Optional[int] = ..., delivered: _Optional[_Iterable[bool]] = ..., left: _Optional[_Iterable[float]] = ..., right: _Optional[_Iterable[float]] = ..., lag: _Optional[float] = ..., facing: _Optional[float] = ...) -> None: ...

class Search(_message.Message):
    __slots__ = ("length", "signals", "cost", "history", "evaluations", "stopped")
    LENGTH_FIELD_NUMBER: _ClassVar[int]
    SIGNALS_FIELD_NUMBER: _ClassVar[int]
    COST_FIELD_NUMBER: _ClassVar[int]
    HISTORY_FIELD_NUMBER: _ClassVar[int]
    EVALUATIONS_FIELD_NUMBER: _ClassVar[int]
    STOPPED_FIELD_NUMBER: _ClassVar[int]
    length: int
    signals: _containers.RepeatedScalarFieldContainer[float]
    cost: float
    history: _containers.RepeatedScalarFieldContainer[float]
    evaluations: int
    stopped: str
    def __init__(self, length: _Optional[int] = ..., signals: _Optional[_Iterable[float]] = ..., cost: _Optional[float] = ..., history: _Optional[_Iterable[float]] = ..., evaluations: _Optional[int] = ..., stopped: _Optional[str] = ...) -> None: ...

class Estimate(_message.Message):
    __slots__ = ("a", "a_std", "speed", "speed_std", "heading_bias", "heading_bias_std", "dead_time", "dead_time_std", "misfit", "side", "side_std", "saturation", "stands", "lag", "lag_std")
    A_FIELD_NUMBER: _ClassVar[int]
    A_STD_FIELD_NUMBER: _ClassVar[int]
    SPEED_FIELD_NUMBER: _ClassVar[int]
    SPEED_STD_FIELD_NUMBER: _ClassVar[int]
    HEADING_BIAS_FIELD_NUMBER: _ClassVar[int]
    HEADING_BIAS_STD_FIELD_NUMBER: _ClassVar[int]
    DEAD_TIME_FIELD_NUMBER: _ClassVar[int]
    DEAD_TIME_STD_FIELD_NUMBER: _ClassVar[int]
    MISFIT_FIELD_NUMBER: _ClassVar[int]
    SIDE_FIELD_NUMBER: _ClassVar[int]
    SIDE_STD_FIELD_NUMBER: _ClassVar[int]
    SATURATION_FIELD_NUMBER: _ClassVar[int]
    STANDS_FIELD_NUMBER: _ClassVar[int]
    LAG_FIELD_NUMBER: _ClassVar[int]
    LAG_STD_FIELD_NUMBER: _ClassVar[int]
    a: _containers.RepeatedScalarFieldContainer[float]
    a_std: _containers.RepeatedScalarFieldContainer[float]
    speed: _containers.RepeatedScalarFieldContainer[float]
    speed_std: _containers.RepeatedScalarFieldContainer[float]
    heading_bias: _containers.RepeatedScalarFieldContainer[float]
    heading_bias_std: _containers.RepeatedScalarFieldContainer[float]
    dead_time: float
    dead_time_std: float
    misfit: _containers.RepeatedScalarFieldContainer[float]
    side: _containers.RepeatedScalarFieldContainer[float]
    side_std: _containers.RepeatedScalarFieldContainer[float]
    saturation: _containers.RepeatedScalarFieldContainer[float]
    stands: _containers.RepeatedScalarFieldContainer[float]
    lag: _containers.RepeatedScalarFieldContainer[float]
    lag_std: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, a: _Optional[_Iterable[float]] = ..., a_std: _Optional[_Iterable[float]] = ..., speed: _Optional[_Iterable[float]] = ..., speed_std: _Optional[_Iterable[float]] = ..., heading_bias: _Optional[_Iterable[float]] = ..., heading_bias_std: _Optional[_Iterable[float]] = ..., dead_time: _Optional[float] = ..., dead_time_std: _Optional[float] = ..., misfit: _Optional[_Iterable[float]] = ..., side: _Optional[_Iterable[float]] = ..., side_std: _Optional[_Iterable[float]] = ..., saturation: _Optional[_Iterable[float]] = ..., stands: _Optional[_Iterable[float]] = ..., lag: _Optional[_Iterable[float]] = ..., lag_std: _Optional[_Iterable[float]] = ...) -> None: ...

class Number(_message.Message):
    __slots__ = ("name", "value")
    NAME_FIELD_NUMBER: _ClassVar[int]
    VALUE_FIELD_NUMBER: _ClassVar[int]
    name: str
    value: float
    def __init__(self, name: _Optional[str] = ..., value: _Optional[float] = ...) -> None: ...

class ControllerStep(_message.Message):
    __slots__ = ("k", "observation", "command", "signals", "cost", "target_cost", "obstacle_cost", "searches", "chosen", "generator", "path_x", "path_y", "leg", "delay_ns", "state", "estimate", "numbers")
    K_FIELD_NUMBER: _ClassVar[int]
    OBSERVATION_FIELD_NUMBER: _ClassVar[int]
    COMMAND_FIELD_NUMBER: _ClassVar[int]
    SIGNALS_FIELD_NUMBER: _ClassVar[int]
    COST_FIELD_NUMBER: _ClassVar[int]
    TARGET_COST_FIELD_NUMBER: _ClassVar[int]
    OBSTACLE_COST_FIELD_NUMBER: _ClassVar[int]
    SEARCHES_FIELD_NUMBER: _ClassVar[int]
    CHOSEN_FIELD_NUMBER: _ClassVar[int]
    GENERATOR_FIELD_NUMBER: _ClassVar[int]
    PATH_X_FIELD_NUMBER: _ClassVar[int]
    PATH_Y_FIELD_NUMBER: _ClassVar[int]
    LEG_FIELD_NUMBER: _ClassVar[int]
    DELAY_NS_FIELD_NUMBER: _ClassVar[int]
    STATE_FIELD_NUMBER: _ClassVar[int]
    ESTIMATE_FIELD_NUMBER: _ClassVar[int]
    NUMBERS_FIELD_NUMBER: _ClassVar[int]
    k: int
    observation: MocapSample
    command: WheelCommand
    signals: _containers.RepeatedScalarFieldContainer[float]
    cost: float
    target_cost: float
    obstacle_cost: float
    searches: _containers.RepeatedCompositeFieldContainer[Search]
    chosen: int
    generator: int
    path_x: _containers.RepeatedScalarFieldContainer[float]
    path_y: _containers.RepeatedScalarFieldContainer[float]
    leg: int
    delay_ns: int
    state: str
    estimate: Estimate
    numbers: _containers.RepeatedCompositeFieldContainer[Number]
    def __init__(self, k: _Optional[int] = ..., observation: _Optional[_Union[MocapSample, _Mapping]] = ..., command: _Optional[_Union[WheelCommand, _Mapping]] = ..., signals: _Optional[_Iterable[float]] = ..., cost: _Optional[float] = ..., target_cost: _Optional[float] = ..., obstacle_cost: _Optional[float] = ..., searches: _Optional[_Iterable[_Union[Search, _Mapping]]] = ..., chosen: _Optional[int] = ..., generator: _Optional[int] = ..., path_x: _Optional[_Iterable[float]] = ..., path_y: _Optional[_Iterable[float]] = ..., leg: _Optional[int] = ..., delay_ns: _Optional[int] = ..., state: _Optional[str] = ..., estimate: _Optional[_Union[Estimate, _Mapping]] = ..., numbers: _Optional[_Iterable[_Union[Number, _Mapping]]] = ...) -> None: ...

class StepTiming(_message.Message):
    __slots__ = ("k", "solve_ns", "deadline_missed")
    K_FIELD_NUMBER: _ClassVar[int]
    SOLVE_NS_FIELD_NUMBER: _ClassVar[int]
    DEADLINE_MISSED_FIELD_NUMBER: _ClassVar[int]
    k: int
    solve_ns: int
    deadline_missed: bool
    def __init__(self, k: _Optional[int] = ..., solve_ns: _Optional[int] = ..., deadline_missed: bool = ...) -> None: ...

class Fact(_message.Message):
    __slots__ = ("key", "value")
    KEY_FIELD_NUMBER: _ClassVar[int]
    VALUE_FIELD_NUMBER: _ClassVar[int]
    key: str
    value: str
    def __init__(self, key: _Optional[str] = ..., value: _Optional[str] = ...) -> None: ...

class Run(_message.Message):
    __slots__ = ("format_version", "run_id", "mode", "name", "trial", "seed", "spec_hash", "spec_name", "robots", "unit", "start_unix_ns", "plant", "camera_rate_hz", "facts")
    FORMAT_VERSION_FIELD_NUMBER: _ClassVar[int]
    RUN_ID_FIELD_NUMBER: _ClassVar[int]
    MODE_FIELD_NUMBER: _ClassVar[int]
    NAME_FIELD_NUMBER: _ClassVar[int]
    TRIAL_FIELD_NUMBER: _ClassVar[int]
    SEED_FIELD_NUMBER: _ClassVar[int]
    SPEC_HASH_FIELD_NUMBER: _ClassVar[int]
    SPEC_NAME_FIELD_NUMBER: _ClassVar[int]
    ROBOTS_FIELD_NUMBER: _ClassVar[int]
    UNIT_FIELD_NUMBER: _ClassVar[int]
    START_UNIX_NS_FIELD_NUMBER: _ClassVar[int]
    PLANT_FIELD_NUMBER: _ClassVar[int]
    CAMERA_RATE_HZ_FIELD_NUMBER: _ClassVar[int]
    FACTS_FIELD_NUMBER: _ClassVar[int]
    format_version: int
    run_id: str
    mode: str
    name: str
    trial: int
    seed: int
    spec_hash: str
    spec_name: str
    robots: _containers.RepeatedScalarFieldContainer[str]
    unit: str
    start_unix_ns: int
    plant: str
    camera_rate_hz: float
    facts: _containers.RepeatedCompositeFieldContainer[Fact]
    def __init__(self, format_version: _Optional[int] = ..., run_id: _Optional[str] = ..., mode: _Optional[str] = ..., name: _Optional[str] = ..., trial: _Optional[int] = ..., seed: _Optional[int] = ..., spec_hash: _Optional[str] = ..., spec_name: _Optional[str] = ..., robots: _Optional[_Iterable[str]] = ..., unit: _Optional[str] = ..., start_unix_ns: _Optional[int] = ..., plant: _Optional[str] = ..., camera_rate_hz: _Optional[float] = ..., facts: _Optional[_Iterable[_Union[Fact, _Mapping]]] = ...) -> None: ...

class Host(_message.Message):
    __slots__ = ("facts",)
    FACTS_FIELD_NUMBER: _ClassVar[int]
    facts: _containers.RepeatedCompositeFieldContainer[Fact]
    def __init__(self, facts: _Optional[_Iterable[_Union[Fact, _Mapping]]] = ...) -> None: ...

class Result(_message.Message):
    __slots__ = ("outcome", "reason", "unit", "steps", "duration_s", "total_error", "robot_errors", "entered", "clearance", "edge", "apart", "final_x", "final_y", "final_heading", "passed", "inside", "lost", "warnings", "turn", "turn_std", "wheel_lag")
    OUTCOME_FIELD_NUMBER: _ClassVar[int]
    REASON_FIELD_NUMBER: _ClassVar[int]
    UNIT_FIELD_NUMBER: _ClassVar[int]
    STEPS_FIELD_NUMBER: _ClassVar[int]
    DURATION_S_FIELD_NUMBER: _ClassVar[int]
    TOTAL_ERROR_FIELD_NUMBER: _ClassVar[int]
    ROBOT_ERRORS_FIELD_NUMBER: _ClassVar[int]
    ENTERED_FIELD_NUMBER: _ClassVar[int]
    CLEARANCE_FIELD_NUMBER: _ClassVar[int]
    EDGE_FIELD_NUMBER: _ClassVar[int]
    APART_FIELD_NUMBER: _ClassVar[int]
    FINAL_X_FIELD_NUMBER: _ClassVar[int]
    FINAL_Y_FIELD_NUMBER: _ClassVar[int]
    FINAL_HEADING_FIELD_NUMBER: _ClassVar[int]
    PASSED_FIELD_NUMBER: _ClassVar[int]
    INSIDE_FIELD_NUMBER: _ClassVar[int]
    LOST_FIELD_NUMBER: _ClassVar[int]
    WARNINGS_FIELD_NUMBER: _ClassVar[int]
    TURN_FIELD_NUMBER: _ClassVar[int]
    TURN_STD_FIELD_NUMBER: _ClassVar[int]
    WHEEL_LAG_FIELD_NUMBER: _ClassVar[int]
    outcome: str
    reason: str
    unit: str
    steps: int
    duration_s: float
    total_error: float
    robot_errors: _containers.RepeatedScalarFieldContainer[float]
    entered: _containers.RepeatedScalarFieldContainer[bool]
    clearance: _containers.RepeatedScalarFieldContainer[float]
    edge: _containers.RepeatedScalarFieldContainer[float]
    apart: _containers.RepeatedScalarFieldContainer[float]
    final_x: _containers.RepeatedScalarFieldContainer[float]
    final_y: _containers.RepeatedScalarFieldContainer[float]
    final_heading: _containers.RepeatedScalarFieldContainer[float]
    passed: _containers.RepeatedScalarFieldContainer[float]
    inside: _containers.RepeatedScalarFieldContainer[float]
    lost: _containers.RepeatedScalarFieldContainer[int]
    warnings: int
    turn: _containers.RepeatedScalarFieldContainer[float]
    turn_std: _containers.RepeatedScalarFieldContainer[float]
    wheel_lag: float
    def __init__(self, outcome: _Optional[str] = ..., reason: _Optional[str] = ..., unit: _Optional[str] = ..., steps: _Optional[int] = ..., duration_s: _Optional[float] = ..., total_error: _Optional[float] = ..., robot_errors: _Optional[_Iterable[float]] = ..., entered: _Optional[_Iterable[bool]] = ..., clearance: _Optional[_Iterable[float]] = ..., edge: _Optional[_Iterable[float]] = ..., apart: _Optional[_Iterable[float]] = ..., final_x: _Optional[_Iterable[float]] = ..., final_y: _Optional[_Iterable[float]] = ..., final_heading: _Optional[_Iterable[float]] = ..., passed: _Optional[_Iterable[float]] = ..., inside: _Optional[_Iterable[float]] = ..., lost: _Optional[_Iterable[int]] = ..., warnings: _Optional[int] = ..., turn: _Optional[_Iterable[float]] = ..., turn_std: _Optional[_Iterable[float]] = ..., wheel_lag: _Optional[float] = ...) -> None: ...

class HostEnd(_message.Message):
    __slots__ = ("solve_ns", "deadline_misses", "ended", "drove")
    SOLVE_NS_FIELD_NUMBER: _ClassVar[int]
    DEADLINE_MISSES_FIELD_NUMBER: _ClassVar[int]
    ENDED_FIELD_NUMBER: _ClassVar[int]
    DROVE_FIELD_NUMBER: _ClassVar[int]
    solve_ns: _containers.RepeatedScalarFieldContainer[int]
    deadline_misses: int
    ended: str
    drove: _containers.RepeatedScalarFieldContainer[bool]
    def __init__(self, solve_ns: _Optional[_Iterable[int]] = ..., deadline_misses: _Optional[int] = ..., ended: _Optional[str] = ..., drove: _Optional[_Iterable[bool]] = ...) -> None: ...

class Digests(_message.Message):
    __slots__ = ("content", "host")
    CONTENT_FIELD_NUMBER: _ClassVar[int]
    HOST_FIELD_NUMBER: _ClassVar[int]
    content: str
    host: str
    def __init__(self, content: _Optional[str] = ..., host: _Optional[str] = ...) -> None: ...

class Recovered(_message.Message):
    __slots__ = ("source", "source_bytes", "source_sha256", "problems", "lost")
    SOURCE_FIELD_NUMBER: _ClassVar[int]
    SOURCE_BYTES_FIELD_NUMBER: _ClassVar[int]
    SOURCE_SHA256_FIELD_NUMBER: _ClassVar[int]
    PROBLEMS_FIELD_NUMBER: _ClassVar[int]
    LOST_FIELD_NUMBER: _ClassVar[int]
    source: str
    source_bytes: int
    source_sha256: str
    problems: _containers.RepeatedScalarFieldContainer[str]
    lost: _containers.RepeatedScalarFieldContainer[str]
    def __init__(self, source: _Optional[str] = ..., source_bytes: _Optional[int] = ..., source_sha256: _Optional[str] = ..., problems: _Optional[_Iterable[str]] = ..., lost: _Optional[_Iterable[str]] = ...) -> None: ...
