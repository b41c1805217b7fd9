// Reads a log by the official JavaScript reader's index, checking the checksum of every chunk, and
// prints as JSON what a message of each channel decodes to by the schema that the log carries.
import { McapIndexedReader } from "@mcap/core";
import { FileHandleReadable } from "@mcap/nodejs";
import { loadDecompressHandlers, protobufFromBinaryDescriptor } from "@mcap/support";
import { open } from "node:fs/promises";

const file = await open(process.argv[2], "r");
const reader = await McapIndexedReader.Initialize({
  readable: new FileHandleReadable(file),
  decompressHandlers: await loadDecompressHandlers(),
});

const types = new Map();
for (const schema of reader.schemasById.values()) {
  types.set(schema.id, protobufFromBinaryDescriptor(schema.data).lookupType(schema.name));
}

const channels = {};
for await (const message of reader.readMessages({ validateCrcs: true })) {
  const channel = reader.channelsById.get(message.channelId);
  const type = types.get(channel.schemaId);
  const found = (channels[channel.topic] ??= { type: type.fullName, count: 0 });
  found.count += 1;
  if (found.count === 1) {
    found.logTime = message.logTime.toString();
    found.publishTime = message.publishTime.toString();
    found.first = type.toObject(type.decode(message.data), { longs: String, bytes: String });
  }
}

const attachments = {};
for await (const record of reader.readAttachments({ validateCrcs: true })) {
  attachments[record.name] = new TextDecoder().decode(record.data);
}
await file.close();
console.log(JSON.stringify({ channels, attachments }));
