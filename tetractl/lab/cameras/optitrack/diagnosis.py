"""Explain why an OptiTrack camera shows no robots, and which setting to change."""

from tetractl.core.errors import AbortError, WireError, printable
from tetractl.lab.cameras.optitrack import natnet
from tetractl.lab.cameras.optitrack.payloads import LAYOUTS
from tetractl.lab.cameras.optitrack.section import OptitrackSection, TrackedRobot
from tetractl.lab.cameras.optitrack.sender_filter import SenderFilter
from tetractl.lab.cameras.optitrack.stream import NatNetStream
from tetractl.lab.cameras.optitrack.wire import parse_datagram
from tetractl.spec.yaml.problems import SHOWN_LENGTH, suggest_similar

BODIES_SHOWN_MAX = 12
"""Maximum number of rigid bodies that a message lists."""


def create_no_server_error(
    section: OptitrackSection, senders: SenderFilter, timeout_s: float
) -> AbortError:
    """Create the error for a server that did not answer CONNECT.

    Args:
        section: The section of the camera.
        senders: What was received from which sender.
        timeout_s: How long the client waited [s].
    """
    address = f"{section.server}:{section.command_port}"
    refused = senders.find_main_refused_sender(sends_frames=False)
    if refused is not None:
        sender, _ = refused
        return AbortError(
            f"no camera server answers at {address} within {timeout_s:g} s, but one answers "
            f"from {sender}",
            f"set lab.camera.server to {sender.host} and lab.camera.command_port to {sender.port}",
        )
    return AbortError(
        f"no camera server answers at {address} within {timeout_s:g} s",
        "is Motive running and streaming? Is lab.camera.server its address? Does a firewall "
        "block UDP?",
    )


def create_no_frames_error(
    section: OptitrackSection, senders: SenderFilter, stream: NatNetStream, timeout_s: float
) -> AbortError:
    """Create the error for a server that answers but sends no usable frame.

    Args:
        section: The section of the camera.
        senders: What was received from which sender.
        stream: What was received from the server.
        timeout_s: How long the client waited [s].
    """
    server = f"the camera server at {section.server}:{section.command_port} answers"
    refused = senders.find_main_refused_sender(sends_frames=True)
    if refused is not None and not stream.counts.unread_frames:
        sender, count = refused
        protocol = _find_fitting_protocol(senders.refused_frame, stream)
        description = (
            f"{count} frames came from {sender} within {timeout_s:g} s, and they fit {protocol}"
        )
        if sender.host != section.server:
            return AbortError(
                f"{server}, but its frames come from another address: {description}",
                f"set lab.camera.server to {sender.host}, or set the local interface in "
                f"Motive to {section.server}",
            )
        return AbortError(
            f"{server}, but its frames do not come from the port that it reports, "
            f"{senders.frames_port}: {description}",
            f"set the data port in Motive to {sender.port}; or does a second program stream to it?",
        )
    if stream.counts.unread_frames:
        return _create_unread_error(server, stream, timeout_s)
    return AbortError(
        f"{server}, but no frames came within {timeout_s:g} s",
        f"does Motive stream in {section.transport}? Multicast frames come from "
        f"{section.group}:{section.data_port}, through the network card that "
        "lab.camera.interface names",
    )


def _create_unread_error(server: str, stream: NatNetStream, timeout_s: float) -> AbortError:
    """Create the error for a server whose frames cannot be read in its protocol version."""
    assert stream.info is not None and stream.version is not None, "it answers"
    server_version = stream.info.version
    protocol = _find_fitting_protocol(stream.last_unread_frame, stream)
    frames_text = (
        f"{stream.counts.unread_frames} frames came within {timeout_s:g} s, and they fit {protocol}"
    )
    if stream.version != server_version:
        return AbortError(
            f"{server}, but its frames do not follow protocol {stream.version}, which "
            f"lab.camera.version requests: {frames_text}",
            f"remove lab.camera.version, because the server uses its own version, {server_version}",
        )
    if server_version > natnet.NEWEST:
        hint = f"set lab.camera.transport to unicast and lab.camera.version to {natnet.NEWEST}"
    else:
        hint = (
            "in unicast, set lab.camera.version to the protocol that the frames fit; "
            "otherwise restart Motive"
        )
    return AbortError(
        f"{server} and reports protocol {server_version}, but its frames cannot be read: "
        f"{frames_text}",
        hint,
    )


def _find_fitting_protocol(frame: bytes, stream: NatNetStream) -> str:
    """Find a protocol version that fits the layout of a frame, and return it as text.

    The server's own version is tried first.
    """
    reported = [] if stream.info is None else [stream.info.version]
    for version in (*reported, *reversed(LAYOUTS)):
        try:
            parse_datagram(frame, version)
        except WireError:
            continue
        return f"protocol {version}"
    return "no known protocol"


def create_up_axis_error(stream: NatNetStream) -> AbortError:
    """Create the error for a server whose vertical axis is unknown or cannot be used."""
    if stream.up_axis_answer is None:
        return AbortError(
            "the camera server does not report which of its axes points up",
            "set lab.camera.up_axis to y or z",
        )
    axis = {0: "x"}.get(stream.up_axis_answer, f"of number {stream.up_axis_answer}")
    return AbortError(
        f"the camera server's up axis is {axis}; it must be y or z",
        "change Up Axis in Motive's streaming settings, not lab.camera.up_axis",
    )


def create_names_error(stream: NatNetStream, timeout_s: float) -> AbortError:
    """Create the error for a server that reports no names although the spec names bodies."""
    if stream.counts.unread_models:
        problem = f"its list of rigid bodies cannot be read as protocol {stream.version}"
    else:
        problem = f"it did not answer a request for its rigid bodies within {timeout_s:g} s"
    names = ", ".join(f"'{robot.body}'" for robot in stream.robots if isinstance(robot.body, str))
    streamed_ids = ", ".join(map(str, stream.streamed_ids[:BODIES_SHOWN_MAX])) or "none"
    return AbortError(
        f"the names {names} cannot be found: the camera server streams frames, but {problem}",
        "use ids instead of names, as in lab.camera.robots.0.body; the frames contain the "
        f"ids {streamed_ids}",
    )


def list_bodies(stream: NatNetStream) -> str:
    """List the rigid bodies that the server has named or streamed, in one line.

    At most BODIES_SHOWN_MAX bodies are listed. The line is "none" if there are no bodies.
    """
    names_by_id = (
        {} if stream.model is None else {body_id: name for name, body_id in stream.model.bodies}
    )
    body_ids = tuple(dict.fromkeys((*names_by_id, *stream.streamed_ids)))
    listed = [
        _describe_body(body_id, names_by_id.get(body_id), body_id in stream.streamed_ids)
        for body_id in body_ids[:BODIES_SHOWN_MAX]
    ]
    omitted = (
        [f"{len(body_ids) - BODIES_SHOWN_MAX} more"] if len(body_ids) > BODIES_SHOWN_MAX else []
    )
    return "; ".join((*listed, *omitted)) or "none"


def _describe_body(body_id: int, name: str | None, is_streamed: bool) -> str:
    """Describe a rigid body by its name and id, and mark a body that is not streamed."""
    description = (
        f"id {body_id}" if name is None else f"'{printable(name, SHOWN_LENGTH)}' (id {body_id})"
    )
    return description if is_streamed else f"{description}, not streamed"


def describe_missing_bodies(stream: NatNetStream, names: tuple[str, ...]) -> list[str]:
    """Describe each robot whose rigid body is missing from the newest frame, one line each.

    A line states whether the server has the body (if not, the most similar name or id), and which
    bodies the server has. The result is empty before MODELDEF has arrived. `names` are the names of
    the stream's robots.
    """
    if stream.model is None or not (missing := stream.list_missing_bodies()):
        return []
    named_robots = zip(names, stream.robots, strict=True)
    problems = [
        _describe_missing_body(stream, stream.model, *named_robot)
        for named_robot in named_robots
        if named_robot[1].body in missing
    ]
    if not stream.model.complete:
        problems.append(
            "the camera server's list of rigid bodies could not be read completely: in the spec, "
            "give the ids of the bodies instead of their names"
        )
    return problems


def _describe_missing_body(
    stream: NatNetStream, model: natnet.ModelDef, name: str, robot: TrackedRobot
) -> str:
    body = robot.body
    ids = model.ids()
    if isinstance(body, str):
        description = f"rigid body '{body}' for {name}"
        assigned = {robot.body for robot in stream.robots}
        unassigned = [
            printable(body_name, SHOWN_LENGTH) for body_name in ids if body_name not in assigned
        ]
        suggestion = suggest_similar(body, unassigned)
    else:
        description = f"rigid body with id {body} for {name}"
        closest = min(stream.streamed_ids, key=lambda number: abs(number - body), default=None)
        suggestion = "" if closest is None else f"; the nearest id is {closest}"
    if body in ids or body in ids.values():
        problem = f"does not stream the {description}: switch it on in Motive"
    else:
        problem = f"has no {description}{suggestion}"
    return f"the camera server {problem}; it has {list_bodies(stream)}"


def describe_dropped_datagrams(senders: SenderFilter, stream: NatNetStream) -> list[str]:
    """Describe dropped datagrams, in one line for each reason.

    A datagram is dropped if it comes from an unknown sender, or answers no request. The result is
    empty if no datagram was dropped.
    """
    warnings: list[str] = []
    if senders.refused:
        sender, _ = senders.refused.most_common(1)[0]
        warnings.append(
            f"{senders.refused.total()} datagrams did not come from the camera server and "
            f"were dropped; most came from {sender}"
        )
    if stream.counts.unrequested:
        warnings.append(
            f"{stream.counts.unrequested} answers came without a request and were dropped"
        )
    return warnings
