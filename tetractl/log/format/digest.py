"""Compute the digests of a log: hashes of all its records, which show whether it was changed.

The content digest covers the records that repeat when a trial is run again. Another digest covers
the host records, which describe the machine and the time.
"""

import hashlib

from mcap.records import Attachment

from tetractl.log.format.channels import DIGESTS, HOST_RECORDS, RECOVERED, Record
from tetractl.log.format.tetractl_pb2 import Digests

_UNCOVERED = frozenset({DIGESTS, RECOVERED})


class LogDigests:
    """Computes the digests of a log while its records are read or written.

    Each digest is a SHA-256 over records in file order, without the digests themselves and the
    report of a recovery.

    A record is preceded by the number of its fields, and a field by its length in bytes. Therefore
    two different logs never give the same bytes to hash. The fields of a message are topic, both
    times and data; of an attachment, name, media type and data.
    """

    def __init__(self) -> None:
        self._content = hashlib.sha256()
        self._host = hashlib.sha256()
        self._prefixes: dict[str, bytes] = {}  # first bytes of a message, by topic

    def add(self, record: Record) -> None:
        """Add a record to the digests, in the order of the file.

        The digests themselves and the report of a recovery are ignored, and so is the time of an
        attachment.
        """
        if isinstance(record, Attachment):
            fields = (b"attachment", record.name.encode(), record.media_type.encode(), record.data)
            digest = self._host if record.name in HOST_RECORDS else self._content
            digest.update(b"4;" + b"".join(b"%d:%b" % (len(field), field) for field in fields))
            return
        topic, log_ns, publish_ns, data = record
        if topic in _UNCOVERED:
            return
        prefix = self._prefixes.get(topic)
        if prefix is None:
            name = topic.encode()
            prefix = self._prefixes[topic] = b"4;7:message%d:%b" % (len(name), name)
        times = b"%d %d" % (log_ns, publish_ns)
        # one call of the hash per message, since a log has thousands
        digest = self._host if topic in HOST_RECORDS else self._content
        digest.update(b"%b%d:%b%d:%b" % (prefix, len(times), times, len(data), data))

    def hexdigests(self) -> Digests:
        """Return the digests of all records so far, as 64 hex digits each."""
        return Digests(content=self._content.hexdigest(), host=self._host.hexdigest())
