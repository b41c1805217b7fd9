// Robots that run twist.py in MicroPython: a line asks for one call of a robot's method, and is
// answered by a line.   NODE_PATH=... node micropython_robots.mjs FOLDER_OF_TWIST_PY
import { readFileSync, readSync, writeSync } from "node:fs";
import { createRequire } from "node:module";
import { pathToFileURL } from "node:url";

const found = createRequire(import.meta.url).resolve(
  "@micropython/micropython-webassembly-pyscript/micropython.mjs",
  { paths: [process.env.NODE_PATH ?? "."] },
);
const { loadMicroPython } = await import(pathToFileURL(found).href);
const python = await loadMicroPython({ heapsize: 192 * 1024 });
python.FS.writeFile("/twist.py", readFileSync(process.argv[2] + "/twist.py"));
python.runPython(`
import sys
sys.path.append("/")
from twist import Twist
robots = []

def call(words):
    name, which, *rest = words.split()
    if name == "make":
        robots.append(Twist(int(which), int(rest[0])))
        return str(len(robots) - 1)
    robot, now_ms = robots[int(which)], int(rest[0])
    if name == "battery":
        robot.battery_mv = now_ms
    elif name == "push":
        robot.push(bytes.fromhex(rest[1]), now_ms)
    elif name == "wheels":
        return "%d %d" % robot.wheels(now_ms)
    elif name == "status":
        return str(robot.status(now_ms))
    elif name == "reply":
        return "".join("%02x" % byte for byte in robot.take_reply(now_ms))
    return sys.implementation.name
`);
const call = python.globals.get("call"), bytes = Buffer.alloc(65536);
let text = "";
for (let n; (n = readSync(0, bytes)); ) {
  text += bytes.toString("latin1", 0, n);
  for (let end; (end = text.indexOf("\n")) >= 0; text = text.slice(end + 1)) {
    writeSync(1, call(text.slice(0, end)) + "\n");
  }
}
