"""Explain why an OptiTrack camera shows no robots, and which setting to change."""

from tetractl.core.errors import AbortError, WireError, printable
from tetractl.lab.cameras.optitrack import natnet
from tetractl.lab.cameras.optitrack.payloads import LAYOUTS
from tetractl.lab.cameras.optitrack.section import OptitrackSection, TrackedRobot
from tetractl.lab.cameras.optitrack.sender_filter import SenderFilter
from tetractl.lab.cameras.optitrack.stream import Stream
from tetractl.lab.cameras.optitrack.wire import parse
from tetractl.spec.yaml.problems import SHOWN_LENGTH, did_you_mean

BODIES_SHOWN_MAX = 12  # largest number of rigid bodies listed in a message


def no_server(section: OptitrackSection, senders: SenderFilter, timeout_s: float) -> AbortError:
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


def no_frames(
    section: OptitrackSection, senders: SenderFilter, stream: Stream, timeout_s: float
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
        fits = _find_fitting_protocol(senders.refused_frame, stream)
        came = f"{count} frames came from {sender} within {timeout_s:g} s, and they fit {fits}"
        if sender.host != section.server:
            return AbortError(
                f"{server}, but its frames come from another address: {came}",
                f"set lab.camera.server to {sender.host}, or set the local interface in "
                f"Motive to {section.server}",
            )
        return AbortError(
            f"{server}, but its frames do not come from the port that it reports, "
            f"{senders.frames_port}: {came}",
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


def _create_unread_error(server: str, stream: Stream, timeout_s: float) -> AbortError:
    assert stream.info is not None and stream.version is not None, "it answers"
    server_version = stream.info.version
    protocol = _find_fitting_protocol(stream.unread_frame, stream)
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


def _find_fitting_protocol(frame: bytes, stream: Stream) -> str:
    """Find a protocol version that fits the layout of a frame, and return it as text.

    The server's own version is tried first.
    """
    reported = [] if stream.info is None else [stream.info.version]
    for version in (*reported, *reversed(LAYOUTS)):
        try:
            parse(frame, version)
        except WireError:
            continue
        return f"protocol {version}"
    return "no known protocol"


def create_up_axis_error(stream: Stream) -> AbortError:
    """Create the error for a server whose vertical axis is unknown or cannot be used."""
    if stream.up_answer is None:
        return AbortError(
            "the camera server does not report which of its axes points up",
            "set lab.camera.up_axis to y or z",
        )
    axis = {0: "x"}.get(stream.up_answer, f"of number {stream.up_answer}")
    return AbortError(
        f"the camera server's up axis is {axis}; it must be y or z",
        "change Up Axis in Motive's streaming settings, not lab.camera.up_axis",
    )


def create_names_error(stream: Stream, timeout_s: float) -> AbortError:
    """Create the error for a server that reports no names although the spec names bodies."""
    if stream.counts.unread_models:
        problem = f"its list of rigid bodies cannot be read as protocol {stream.version}"
    else:
        problem = f"it did not answer a request for its rigid bodies within {timeout_s:g} s"
    names = ", ".join(f"'{robot.body}'" for robot in stream.robots if isinstance(robot.body, str))
    streamed_ids = ", ".join(map(str, stream.seen[:BODIES_SHOWN_MAX])) or "none"
    return AbortError(
        f"the names {names} cannot be found: the camera server streams frames, but {problem}",
        "use ids instead of names, as in lab.camera.robots.0.body; the frames contain the "
        f"ids {streamed_ids}",
    )


def list_bodies(stream: Stream) -> str:
    """Return a line that lists the rigid bodies that the server has named or streamed.

    It is "none" if there are none. At most SHOWN bodies are listed.
    """
    names_by_id = (
        {} if stream.model is None else {number: name for name, number in stream.model.bodies}
    )
    numbers = tuple(dict.fromkeys((*names_by_id, *stream.seen)))
    listed = [
        _describe_body(number, names_by_id.get(number), number in stream.seen)
        for number in numbers[:BODIES_SHOWN_MAX]
    ]
    omitted = [f"{len(numbers) - BODIES_SHOWN_MAX} more"] if len(numbers) > BODIES_SHOWN_MAX else []
    return "; ".join((*listed, *omitted)) or "none"


def _describe_body(number: int, name: str | None, streamed: bool) -> str:
    body = f"id {number}" if name is None else f"'{printable(name, SHOWN_LENGTH)}' (id {number})"
    return body if streamed else f"{body}, not streamed"


def describe_missing_bodies(stream: Stream, names: tuple[str, ...]) -> list[str]:
    """Describe each robot whose rigid body is missing from the newest frame, one line each.

    A line states whether the server has the body (if not, the most similar name or id), and which
    bodies the server has. The result is empty before MODELDEF has arrived. `names` are the names of
    the stream's robots.
    """
    if stream.model is None or not (missing := stream.missing()):
        return []
    named_robots = zip(names, stream.robots, strict=True)
    problems = [
        _describe_missing_body(stream, stream.model, *named_robot)
        for named_robot in named_robots
        if named_robot[1].body in missing
    ]
    if not stream.model.complete:
        problems.append(
            "the list of the cameras' rigid bodies could not be read completely: use ids"
        )
    return problems


def _describe_missing_body(
    stream: Stream, model: natnet.ModelDef, name: str, robot: TrackedRobot
) -> str:
    body = robot.body
    ids = model.ids()
    if isinstance(body, str):
        description = f"rigid body '{body}' for {name}"
        assigned = {robot.body for robot in stream.robots}
        unassigned = [
            printable(body_name, SHOWN_LENGTH) for body_name in ids if body_name not in assigned
        ]
        suggestion = did_you_mean(body, unassigned)
    else:
        description = f"rigid body with id {body} for {name}"
        closest = min(stream.seen, key=lambda number: abs(number - body), default=None)
        suggestion = "" if closest is None else f"; the nearest id is {closest}"
    if body in ids or body in ids.values():
        problem = f"do not stream the {description}: switch it on in Motive"
    else:
        problem = f"know no {description}{suggestion}"
    return f"the cameras {problem}; they have {list_bodies(stream)}"


def describe_dropped_datagrams(senders: SenderFilter, stream: Stream) -> list[str]:
    """Return warnings about dropped datagrams, one line each. Empty if none was dropped.

    They came from unknown senders, or were answers without a request.
    """
    warnings: list[str] = []
    if senders.refused:
        sender, _ = senders.refused.most_common(1)[0]
        warnings.append(
            f"{senders.refused.total()} datagrams did not come from the camera server and "
            f"were dropped; most came from {sender}"
        )
    if stream.counts.unasked:
        warnings.append(f"{stream.counts.unasked} answers came without a request and were dropped")
    return warnings
