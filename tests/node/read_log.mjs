// Opens a log by its index with the MCAP project's own reader and prints what it found as JSON.
import { open } from "node:fs/promises";
import { McapIndexedReader } from "@mcap/core";
import { FileHandleReadable } from "@mcap/nodejs";
import { loadDecompressHandlers } from "@mcap/support";

const file = await open(process.argv[2], "r");
const reader = await McapIndexedReader.Initialize({
  readable: new FileHandleReadable(file),
  decompressHandlers: await loadDecompressHandlers(),
});
const messages = {};
let bytes = 0;
for await (const message of reader.readMessages({ validateCrcs: true })) {
  const { topic } = reader.channelsById.get(message.channelId);
  messages[topic] = (messages[topic] ?? 0) + 1;
  bytes += message.data.byteLength;
}
const metadata = {};
for await (const record of reader.readMetadata()) {
  metadata[record.name] = Object.fromEntries(record.metadata);
}
const attachments = [];
for await (const record of reader.readAttachments()) {
  attachments.push(record.name);
}
const counted = Number(reader.statistics.messageCount);
const { profile } = reader.header;
console.log(JSON.stringify({ profile, counted, bytes, messages, metadata, attachments }));
await file.close();
