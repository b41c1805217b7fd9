"""Explain why an OptiTrack camera shows no robots, and which setting to change."""

from tetractl.core.errors import AbortError, WireError, printable
from tetractl.lab.cameras.optitrack import natnet
from tetractl.lab.cameras.optitrack.payloads import LAYOUTS
from tetractl.lab.cameras.optitrack.section import OptitrackSection, TrackedRobot
from tetractl.lab.cameras.optitrack.sender_filter import SenderFilter
from tetractl.lab.cameras.optitrack.stream import Stream
from tetractl.lab.cameras.optitrack.wire import parse
from tetractl.spec.yaml.problems import SHOWN_LENGTH, did_you_mean

SHOWN = 12  # largest number of rigid bodies listed in a message


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
        fits = _reads_as(senders.refused_frame, stream)
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
        return _unread(server, stream, timeout_s)
    return AbortError(
        f"{server}, but no frames came within {timeout_s:g} s",
        f"does Motive stream in {section.transport}? Multicast frames come from "
        f"{section.group}:{section.data_port}, through the network card that "
        "lab.camera.interface names",
    )


def _unread(server: str, stream: Stream, timeout_s: float) -> AbortError:
    assert stream.info is not None and stream.version is not None, "it answers"
    server_version = stream.info.version
    fits = _reads_as(stream.unread_frame, stream)
    came = f"{stream.counts.unread_frames} frames came within {timeout_s:g} s, and they fit {fits}"
    if stream.version != server_version:
        return AbortError(
            f"{server}, but its frames do not follow protocol {stream.version}, which "
            f"lab.camera.version requests: {came}",
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
        f"{server} and reports protocol {server_version}, but its frames cannot be read: {came}",
        hint,
    )


def _reads_as(frame: bytes, stream: Stream) -> str:
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


def no_up_axis(stream: Stream) -> AbortError:
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


def no_names(stream: Stream, timeout_s: float) -> AbortError:
    """Create the error for a server that reports no names although the spec names bodies."""
    if stream.counts.unread_models:
        said = f"its list of rigid bodies cannot be read as protocol {stream.version}"
    else:
        said = f"it did not answer a request for its rigid bodies within {timeout_s:g} s"
    wanted = ", ".join(f"'{r.body}'" for r in stream.robots if isinstance(r.body, str))
    streamed = ", ".join(map(str, stream.seen[:SHOWN])) or "none"
    return AbortError(
        f"the names {wanted} cannot be found: the camera server streams frames, but {said}",
        "use ids instead of names, as in lab.camera.robots.0.body; the frames contain the "
        f"ids {streamed}",
    )


def bodies(stream: Stream) -> str:
    """Return a line that lists the rigid bodies that the server has named or streamed.

    It is "none" if there are none. At most SHOWN bodies are listed.
    """
    named = {} if stream.model is None else {number: name for name, number in stream.model.bodies}
    numbers = tuple(dict.fromkeys((*named, *stream.seen)))
    listed = [_body(number, named.get(number), number in stream.seen) for number in numbers[:SHOWN]]
    more = [f"{len(numbers) - SHOWN} more"] if len(numbers) > SHOWN else []
    return "; ".join((*listed, *more)) or "none"


def _body(number: int, name: str | None, streamed: bool) -> str:
    body = f"id {number}" if name is None else f"'{printable(name, SHOWN_LENGTH)}' (id {number})"
    return body if streamed else f"{body}, not streamed"


def not_streamed(stream: Stream, names: tuple[str, ...]) -> list[str]:
    """Describe each robot whose rigid body is missing from the newest frame, one line each.

    A line states whether the server has the body (if not, the most similar name or id), and which
    bodies the server has. The result is empty before MODELDEF has arrived. `names` are the names of
    the stream's robots.
    """
    if stream.model is None or not (missing := stream.missing()):
        return []
    pairs = zip(names, stream.robots, strict=True)
    lines = [_lacking(stream, stream.model, *pair) for pair in pairs if pair[1].body in missing]
    if not stream.model.complete:
        lines.append("the list of the cameras' rigid bodies could not be read completely: use ids")
    return lines


def _lacking(stream: Stream, model: natnet.ModelDef, name: str, robot: TrackedRobot) -> str:
    body = robot.body
    ids = model.ids()
    if isinstance(body, str):
        wanted = f"rigid body '{body}' for {name}"
        taken = {robot.body for robot in stream.robots}
        free = [printable(body_name, SHOWN_LENGTH) for body_name in ids if body_name not in taken]
        near = did_you_mean(body, free)
    else:
        wanted = f"rigid body with id {body} for {name}"
        closest = min(stream.seen, key=lambda number: abs(number - body), default=None)
        near = "" if closest is None else f"; the nearest id is {closest}"
    if body in ids or body in ids.values():
        why = f"do not stream the {wanted}: switch it on in Motive"
    else:
        why = f"know no {wanted}{near}"
    return f"the cameras {why}; they have {bodies(stream)}"


def not_taken(senders: SenderFilter, stream: Stream) -> list[str]:
    """Return warnings about dropped datagrams, one line each. Empty if none was dropped.

    They came from unknown senders, or were answers without a request.
    """
    lines: list[str] = []
    if senders.refused:
        sender, _ = senders.refused.most_common(1)[0]
        lines.append(
            f"{senders.refused.total()} datagrams did not come from the camera server and "
            f"were dropped; most came from {sender}"
        )
    if stream.counts.unasked:
        lines.append(f"{stream.counts.unasked} answers came without a request and were dropped")
    return lines
