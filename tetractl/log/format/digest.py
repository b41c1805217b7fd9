"""The content digest: a hash of all records that are the same when a trial is run again."""

import hashlib
from collections.abc import Mapping

from tetractl.log.format.channels import HOST_RECORDS, RECOVERED, Entry

CHECKSUM = "checksum"
DIGEST = "content_digest"
HOST_DIGEST = "host_digest"


class ContentDigest:
    """SHA-256 over the records of a log, in file order: over all but the host records or, with
    `host`, over the host records alone. Neither covers the report of a recovery.

    A record is preceded by the number of its fields, and a field by its length in bytes, so that no
    two different logs give the same bytes to hash. The fields of a message are topic, both times
    and data; of metadata, name and items sorted by key, without the checksum and the digests; of an
    attachment, name, media type and data.
    """

    def __init__(self, host: bool = False) -> None:
        self._hash = hashlib.sha256()
        self._host = host
        self._heads: dict[str, bytes] = {}  # first bytes of a message, by topic

    def _covers(self, name: str) -> bool:
        return (name in HOST_RECORDS) == self._host and name != RECOVERED

    def message(self, entry: Entry) -> None:
        """Add one message."""
        topic, log_ns, publish_ns, data = entry
        head = self._heads.get(topic)
        if head is None:
            head = self._heads[topic] = self._head(topic)
        if head:  # one call of the hash per message, since a log has thousands
            times = b"%d %d" % (log_ns, publish_ns)
            self._hash.update(b"%b%d:%b%d:%b" % (head, len(times), times, len(data), data))

    def metadata(self, name: str, items: Mapping[str, str]) -> None:
        """Add one metadata record."""
        if self._covers(name):
            keys = sorted(items.keys() - {CHECKSUM, DIGEST, HOST_DIGEST})
            fields = [text.encode() for key in keys for text in (key, items[key])]
            self._add(b"metadata", name.encode(), *fields)

    def attachment(self, name: str, media_type: str, data: bytes) -> None:
        """Add one attachment."""
        if self._covers(name):
            self._add(b"attachment", name.encode(), media_type.encode(), data)

    def hexdigest(self) -> str:
        """Return the digest of all records so far."""
        return self._hash.hexdigest()

    def _add(self, *fields: bytes) -> None:
        parts = [b"%d;" % len(fields)]
        for field in fields:
            parts += [b"%d:" % len(field), field]
        self._hash.update(b"".join(parts))

    def _head(self, topic: str) -> bytes:
        """Return the bytes to hash for a message of a topic that come before its times; empty if
        the digest leaves out the topic.
        """
        name = topic.encode()
        return b"4;7:message%d:%b" % (len(name), name) if self._covers(topic) else b""
