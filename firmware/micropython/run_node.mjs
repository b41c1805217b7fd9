// Runs the vectors in MicroPython, by the package @micropython/micropython-webassembly-pyscript of
// the folder node_modules that NODE_PATH names:   NODE_PATH=... node run_node.mjs
import { readFileSync } from "node:fs";
import { createRequire } from "node:module";
import { dirname, join } from "node:path";
import { fileURLToPath, pathToFileURL } from "node:url";

const here = dirname(fileURLToPath(import.meta.url));
const found = createRequire(import.meta.url).resolve(
  "@micropython/micropython-webassembly-pyscript/micropython.mjs",
  { paths: [process.env.NODE_PATH ?? here] },
);
const { loadMicroPython } = await import(pathToFileURL(found).href);
const python = await loadMicroPython({ heapsize: 192 * 1024 });
for (const name of ["twist.py", "run_vectors.py"]) {
  python.FS.writeFile("/" + name, readFileSync(join(here, name)));
}
python.globals.set("vectors", readFileSync(join(here, "../tests/twist_vectors.txt"), "utf8"));
python.runPython(`
import sys
sys.path.append("/")
from run_vectors import run
checks, failures = run(vectors)
print("\\n".join(failures + ["%s: %d checks, %d failures" % (sys.implementation.name, checks, len(failures))]))
failed = len(failures) or not checks
`);
process.exit(python.globals.get("failed") ? 1 : 0);
