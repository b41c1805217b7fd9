// The game: a person steers all robots of a spec with one direction, and then watches its controller.

const byId = (id) => document.getElementById(id);
const ARROWS = { ArrowRight: 0, ArrowUp: Math.PI / 2, ArrowLeft: Math.PI, ArrowDown: -Math.PI / 2 };
const CHECK_S = 0.004; // longest time between two checks for obstacles and edges
const AHEAD_S = 2.5; // how far the dots lead
const DRAG_MIN_PX = 12; // shortest drag that sets a direction
const GRIP_PX = 26; // how near a finger must be to a square to take it

// The robots in motion, from step to step, without a picture.
class Trial {
  constructor(world) {
    this.world = world;
    this.poses = world.robots.map(({ start }) => [...start]);
    this.from = this.poses; // at the begin of the present step
    this.step = 0;
    this.u = undefined; // the direction held, before the first step undefined
    this.lost = "";
  }

  get time() { return this.step * this.world.period + this.elapsed; }
  elapsed = 0; // since the begin of the present step [s]

  // Begin the next step with the direction u.
  begin(u) {
    this.u = u;
    this.from = this.poses;
    this.elapsed = 0;
  }

  // Move on within the present step, to `elapsed` seconds after its begin.
  move(elapsed) {
    const checks = Math.max(1, Math.ceil((elapsed - this.elapsed) / CHECK_S));
    const since = this.elapsed;
    for (let i = 1; i <= checks; i++) {
      this.elapsed = i === checks ? elapsed : since + ((elapsed - since) * i) / checks;
      this.poses = this.predict(this.u, this.elapsed, this.from);
      this.lost ||= lostBy(this.world, this.poses);
    }
  }

  // End the present step.
  finish() {
    this.move(this.world.period);
    this.from = this.poses;
    this.elapsed = 0;
    this.step += 1;
  }

  predict(u, seconds, poses = this.poses) {
    const { robots, motion } = this.world;
    return poses.map((pose, r) => MOTIONS[motion](pose, u, robots[r].a, robots[r].speed, seconds));
  }

  // The positions that the robots pass if a direction is held.
  path(u) {
    const { period, motion } = this.world, positions = [this.poses];
    const seconds = motion === "euler" ? period : 0.05; // a step of (4)-(6) is a period
    for (let t = seconds; t <= AHEAD_S; t += seconds)
      positions.push(this.predict(u, seconds, positions.at(-1)));
    return positions;
  }

  // Whether a direction is exactly behind every robot: then a sin(u - heading) is 0.
  facesAway(u) {
    return this.poses.every(([, , heading]) => Math.cos(u - heading) < -1 + 1e-12);
  }

  get distances() { return gaps(this.world, this.poses); }
  get total() { return this.distances.reduce((sum, one) => sum + one, 0); }
  get arrived() {
    const { tolerance } = this.world;
    return tolerance > 0 && this.distances.every((distance) => distance <= tolerance);
  }
  get over() { return this.step * this.world.period > this.world.limit - this.world.period / 2; }
}

// How a robot is lost at these poses, "" if none is.
function lostBy({ arena: [left, bottom, right, top], shapes, robots }, poses) {
  for (const [r, [x, y]] of poses.entries()) {
    if (shapes.some((shape) => distanceToShape(shape, x, y) <= 0)) return `${robots[r].name} drove into an obstacle`;
    if (x < left || x > right || y < bottom || y > top) return `${robots[r].name} drove over the edge`;
  }
  return "";
}

// Drive by a script of keys [seconds, name], as `tetractl play --script` does; return the trial.
function runScript(world, keys) {
  const trial = new Trial(world), first = keys[0][0];
  for (;;) {
    if (trial.arrived || trial.over) return trial;
    const pressed = keys.filter(([at]) => at - first <= trial.step * world.period).map(([, key]) => key);
    if (pressed.some((key) => key === "space" || key === "q")) return trial;
    const arrows = { right: 0, up: Math.PI / 2, left: Math.PI, down: -Math.PI / 2 };
    trial.begin(arrows[pressed.at(-1)]);
    trial.finish();
  }
}

class Game {
  constructor(world, watched) {
    this.original = world;
    this.watched = watched; // the controller's trial, as the report has it
    this.scene = new Scene(byId("scene"));
    this.scene.options.dotted = true;
    this.scene.options.arrow = "direction";
    this.scene.overlay = (context) => this.preview(context);
    this.clock = new FrameClock((seconds) => this.advance(seconds));
    this.rate = 1;
    this.tries = [];
    this.watchedOnce = false;
    this.restore();
  }

  // Put the robots, targets and obstacles of the spec back.
  restore() {
    this.world = structuredClone(this.original);
    this.changed = false;
    this.restart();
  }

  // Put the robots back to their starts.
  restart() {
    this.clock.stop();
    this.phase = "ready";
    this.wish = undefined;
    this.stopping = false;
    this.trial = new Trial(this.world);
    this.picture = {
      ...this.world,
      hold: 0, dish: null, final: null, end: Infinity,
      frames: { t: [], xy: [], heading: [] },
      steps: { t: [], u: [] },
      plan: [],
    };
    this.rows();
    this.note();
    this.show();
    this.say(this.areEqual
      ? "All robots are equal now. Press an arrow, and try to change the gaps between them."
      : "Press an arrow: all robots turn to it as they drive, each at its own rate.");
  }

  // Whether all robots turn and drive alike.
  get areEqual() {
    const { robots } = this.world, [first] = robots;
    return robots.length > 1 && robots.every(({ a, speed }) => a === first.a && speed === first.speed);
  }

  // ---- Hands ----

  bind() {
    document.addEventListener("keydown", (event) => this.key(event));
    for (const button of document.querySelectorAll("[data-key]"))
      button.addEventListener("click", () => this.steer(ARROWS[button.dataset.key]));
    const on = (id, event, action) => byId(id).addEventListener(event, action);
    on("stop", "click", () => this.stop());
    on("pause", "click", () => this.pause());
    on("again", "click", () => this.restart());
    on("controller", "click", () => this.watch());
    on("equal", "click", () => this.equal());
    on("original", "click", () => this.restore());
    on("rate", "change", (event) => { this.rate = Number(event.target.value); });
    on("theme", "click", () => {
      const dark = getComputedStyle(document.documentElement).colorScheme === "dark";
      document.documentElement.dataset.theme = dark ? "light" : "dark";
      this.show();
    });
    on("scene", "pointerdown", (event) => this.grip(event));
    on("scene", "pointermove", (event) => this.drag(event));
    for (const end of ["pointerup", "pointercancel"]) on("scene", end, () => { this.held = undefined; });
    window.addEventListener("resize", () => this.show());
    window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.show());
  }

  key(event) {
    const tag = event.target.tagName;
    if (event.ctrlKey || event.metaKey || event.altKey || tag === "SELECT") return;
    const slides = tag === "INPUT" && event.key.startsWith("Arrow");
    const pushes = tag === "BUTTON" && (event.key === " " || event.key === "Enter");
    if (slides || pushes || (tag === "SUMMARY" && !event.key.startsWith("Arrow"))) return;
    const actions = {
      " ": () => this.stop(), p: () => this.pause(), P: () => this.pause(),
      r: () => this.restart(), R: () => this.restart(), Enter: () => this.watch(),
    };
    const action = event.key in ARROWS ? () => this.steer(ARROWS[event.key]) : actions[event.key];
    if (!action) return;
    event.preventDefault();
    action();
  }

  // Take what lies under the finger: a square or an obstacle in a pause, else the direction.
  grip(event) {
    const canvas = byId("scene"), box = canvas.getBoundingClientRect();
    canvas.setPointerCapture(event.pointerId);
    const at = [event.clientX - box.left, event.clientY - box.top], [x, y] = this.scene.world(...at);
    this.held = { at, moved: () => {} };
    if (this.phase !== "paused") return;
    const { robots, shapes } = this.world;
    const near = robots.findIndex(({ target }) => {
      const [px, py] = this.scene.place(...target);
      return Math.hypot(px - at[0], py - at[1]) < GRIP_PX;
    });
    const shape = shapes.findIndex((one) => distanceToShape(one, x, y) <= 0);
    if (near >= 0) this.held.moved = (dx, dy) => shift([robots[near].target], dx, dy);
    else if (shape >= 0) this.held.moved = (dx, dy) => {
      shift(shapes[shape].corners, dx, dy);
      shift(this.world.obstacles[shape], dx, dy);
    };
    this.held.takes = near >= 0 || shape >= 0;
    this.held.world = [x, y];
  }

  drag(event) {
    if (!this.held) return;
    const box = byId("scene").getBoundingClientRect(), { held } = this;
    const at = [event.clientX - box.left, event.clientY - box.top];
    if (held.takes) {
      const [x, y] = this.scene.world(...at);
      held.moved(x - held.world[0], y - held.world[1]);
      held.world = [x, y];
      this.changed = true;
      this.show();
      return;
    }
    const [dx, dy] = [at[0] - held.at[0], held.at[1] - at[1]];
    if (Math.hypot(dx, dy) >= DRAG_MIN_PX) this.steer(Math.atan2(dy, dx));
  }

  // ---- The trial ----

  steer(u) {
    if (this.phase === "ended" || this.phase === "watched") this.say("Press R for another try, or Enter for the controller.");
    if (!["ready", "driving", "paused"].includes(this.phase)) return;
    this.wish = u;
    if (this.phase === "ready") {
      this.phase = "driving";
      this.begin();
      this.say(this.trial.facesAway(u)
        ? "This direction is exactly behind the robots. Left and right are equally far, so they turn neither way and drive straight on."
        : "The dots show where this direction leads. Stop (space) when every robot is in its square.");
      this.clock.start();
    } else if (this.phase === "paused") this.show();
    else this.plan();
  }

  stop() {
    if (this.phase === "driving") this.stopping = true; // at the end of the present step
    else if (this.phase === "paused") this.end("You stopped the robots.");
    else if (this.phase === "watching") this.finishWatching();
  }

  pause() {
    if (this.phase === "driving") {
      this.phase = "paused";
      this.clock.stop();
      this.say("Paused. Dots show where each arrow would lead. Drag a square or an obstacle to move it.");
      this.show();
    } else if (this.phase === "paused") {
      this.phase = "driving";
      this.say("The dots show where this direction leads. Stop (space) when every robot is in its square.");
      this.clock.start();
    }
  }

  // Begin the next step with the direction that is wanted now.
  begin() {
    this.trial.begin(this.wish);
    this.picture.steps.t.push(this.trial.time);
    this.picture.steps.u.push(this.wish);
    this.picture.plan.push(undefined);
    this.plan();
  }

  // Plan the dots: the direction that is wanted, from the present poses.
  plan() {
    if (this.picture.plan.length) this.picture.plan[this.picture.plan.length - 1] = this.trial.path(this.wish);
  }

  // Drive for some seconds; return whether the trial goes on then.
  advance(seconds) {
    if (this.phase === "watching") return this.advanceWatching(seconds);
    const { trial } = this, { period } = this.world;
    let left = Math.min(seconds, 0.25) * this.rate; // a hidden page stands still
    while (left > 0 && this.phase === "driving") {
      const rest = period - trial.elapsed;
      if (left < rest) {
        trial.move(trial.elapsed + left);
        left = 0;
        if (trial.lost) this.end(`Lost: ${trial.lost}.`);
      } else {
        trial.finish();
        left -= rest;
        this.note();
        if (trial.lost) this.end(`Lost: ${trial.lost}.`);
        else if (trial.arrived) this.end("Arrived.");
        else if (this.stopping) this.end("You stopped the robots.");
        else if (trial.over) this.end("The time is over.");
        else this.begin();
      }
    }
    this.note();
    if (this.phase === "driving") this.plan();
    this.show();
    return this.phase === "driving";
  }

  // Keep the present poses for the trails.
  note() {
    const { t, xy, heading } = this.picture.frames, { poses } = this.trial;
    if (t.at(-1) === this.trial.time) return;
    t.push(this.trial.time);
    xy.push(poses.map(([x, y]) => [x, y]));
    heading.push(poses.map((pose) => pose[2]));
  }

  end(why) {
    const { trial } = this;
    this.phase = "ended";
    this.clock.stop();
    this.tries.push({ total: trial.total, seconds: trial.time, lost: trial.lost, changed: this.changed });
    const lesson = this.areEqual
      ? " All robots are equal, so the same direction moves them alike, and the gaps between them stay as they are."
      : "";
    this.say(`${why} Your error: ${this.length(trial.total)} after ${trial.time.toFixed(1)} s.${lesson}`
      + " Try again (R), or watch the controller (Enter).");
    this.show();
  }

  // ---- The controller ----

  watch() {
    if (this.phase === "driving" || this.phase === "paused") {
      this.say("Stop the robots first (space). Then the controller has its try.");
      return;
    }
    if (this.phase === "watching") { this.finishWatching(); return; }
    this.phase = "watching";
    this.time = 0;
    this.rows();
    const other = this.changed ? "The original robots, targets and obstacles, for which it was computed. " : "";
    this.say(`The controller's turn. ${other}The dots are its plan, which it makes again at each step.`);
    this.clock.start();
  }

  advanceWatching(seconds) {
    this.time = Math.min(this.time + Math.min(seconds, 0.25) * this.rate, this.watched.end);
    if (this.time >= this.watched.end) this.finishWatching();
    this.show();
    return this.phase === "watching" && this.time < this.watched.end;
  }

  finishWatching() {
    this.clock.stop();
    this.time = this.watched.end;
    this.phase = "watched";
    this.watchedOnce = true;
    const best = this.best(), mine = best ? ` Your best of ${this.compared().length}: ${this.length(best.total)}.` : "";
    const which = this.changed ? " (with the original robots)" : "";
    this.say(`The controller${which}: ${this.length(sum(this.watched.final.errors))} after ${this.time.toFixed(1)} s.${mine}`
      + " All robots received the same directions. Because each turns at its own rate, every turn changes the gaps"
      + " between them, and the right turns in the right order bring each one home.");
    this.show();
  }

  // ---- What is changed ----

  rows() {
    const { robots } = this.watches ? this.original : this.world, letters = robotLetters(robots);
    byId("robots").replaceChildren(...robots.map((robot, r) => {
      const row = robotRow(robot, letters[r], 2);
      this.slider(row.children[1], robot, "a", "turning rate");
      this.slider(row.children[2], robot, "speed", "speed");
      return row;
    }));
    byId("distances").replaceChildren(...robots.map((robot, r) => {
      const one = document.createElement("span"), mark = robotMark(robot, letters[r]);
      one.append(mark, "");
      return one;
    }));
  }

  // A slider for a value of a robot; all robots' sliders have the same ends.
  slider(cell, robot, field, words) {
    const input = document.createElement("input"), value = document.createElement("output");
    const values = this.original.robots.map((one) => one[field]);
    const min = 0.25 * Math.min(...values), max = 1.5 * Math.max(...values);
    Object.assign(input, { type: "range", min, max, step: (max - min) / 200, disabled: this.watches });
    input.value = robot[field];
    input.setAttribute("aria-label", `${words} of ${robot.name}`);
    value.textContent = digits(robot[field]);
    input.addEventListener("input", () => {
      robot[field] = Number(input.value);
      value.textContent = digits(robot[field]);
      this.change();
    });
    cell.append(input, value);
  }

  equal() {
    const { robots } = this.world, mean = (field) => sum(robots.map((robot) => robot[field])) / robots.length;
    const a = mean("a"), speed = mean("speed");
    for (const robot of robots) Object.assign(robot, { a, speed });
    this.change();
    this.restart();
  }

  // Whether the controller's trial is shown.
  get watches() {
    return this.phase === "watching" || this.phase === "watched";
  }

  // Another robot: the present step goes on from here, and the controller's trial is for others.
  change() {
    this.changed = true;
    const { trial } = this;
    if (this.phase === "driving" || this.phase === "paused") {
      const left = this.world.period - trial.elapsed;
      trial.from = trial.poses;
      trial.world = { ...this.world, period: left };
      this.plan();
    }
    this.show();
  }

  // ---- What is shown ----

  // The dots of every arrow, in a pause.
  preview(context) {
    if (this.phase !== "paused") return;
    context.globalAlpha = 0.55;
    for (const u of Object.values(ARROWS)) this.scene.paths(context, this.trial.path(u), true);
    context.globalAlpha = 1;
    if (this.wish !== undefined) this.scene.paths(context, this.trial.path(this.wish), true);
  }

  show() {
    const watching = this.watches;
    const time = watching ? this.time : this.trial.time;
    const picture = watching ? this.watched : this.picture;
    if (this.scene.trial !== picture) this.scene.show(picture, () => {});
    this.scene.options.plan = this.phase === "driving" || this.phase === "watching";
    this.scene.draw(time);
    const moves = this.phase === "driving" || this.phase === "watching";
    const tenth = moves && `${this.phase} ${Math.floor(10 * time)}`;
    if (!tenth || tenth !== this.tenth) this.numbers(time, watching);
    this.tenth = tenth;
  }

  // Write what stands beside the arena. While robots move, this is done ten times a second: nobody
  // could read more, and the browser lays out the page each time.
  numbers(time, watching) {
    const distances = watching ? distancesAt(this.watched, time) : this.trial.distances;
    [...byId("distances").children].forEach((one, r) => { one.lastChild.data = digits(distances[r]); });
    byId("total").textContent = `${watching ? "controller's" : "total"} error ${this.length(sum(distances))}, ${time.toFixed(1)} s`;
    const lost = this.phase === "driving" || this.phase === "paused" ? this.trial.lost : "";
    byId("lost").textContent = lost && `Lost: ${lost}.`;
    byId("lost").hidden = !lost;
    byId("pause").firstChild.data = this.phase === "paused" ? "Go on " : "Pause ";
    byId("pause").disabled = !["driving", "paused"].includes(this.phase);
    byId("stop").disabled = !["driving", "paused", "watching"].includes(this.phase);
    this.results();
  }

  results() {
    const rows = [], best = this.best();
    if (best) rows.push([`you, best of ${this.compared().length}`, this.described(best)]);
    if (this.tries.length > 1) rows.push(["you, last", this.described(this.tries.at(-1))]);
    if (this.watchedOnce) {
      const other = this.changed ? ", computed for the original robots, targets and obstacles" : "";
      rows.push(["the controller", `${this.length(sum(this.watched.final.errors))} after ${this.watched.end.toFixed(1)} s${other}`]);
    }
    const key = JSON.stringify(rows);
    if (key === this.shownResults) return;
    this.shownResults = key;
    byId("results").replaceChildren(...rows.map((words) => {
      const row = document.createElement("tr");
      const head = document.createElement("th"), cell = document.createElement("td");
      head.scope = "row";
      [head.textContent, cell.textContent] = words;
      row.append(head, cell);
      return row;
    }));
    byId("results").parentElement.hidden = !rows.length;
  }

  described({ total, seconds, lost, changed }) {
    const notes = [lost && `lost: ${lost}`, changed && "with changed robots, targets or obstacles"].filter(Boolean);
    return `${this.length(total)} after ${seconds.toFixed(1)} s${notes.length ? ` (${notes.join("; ")})` : ""}`;
  }

  // The tries that can be compared with the controller's: those with the original robots, if there
  // are any.
  compared() {
    const original = this.tries.filter(({ changed }) => !changed);
    return original.length ? original : this.tries;
  }

  // The try with the least error that is not lost; if all are lost, of all.
  best() {
    const tries = this.compared(), kept = tries.filter(({ lost }) => !lost);
    return (kept.length ? kept : tries).toSorted((one, other) => one.total - other.total)[0];
  }

  length(value) {
    const { unit, arena: [left, , right] } = this.world, least = 10 ** (Math.floor(Math.log10(right - left)) - 5);
    return value < least ? `< ${least} ${unit}` : `${digits(value)} ${unit}`;
  }

  say(text) {
    byId("message").textContent = text;
  }
}

function sum(values) {
  return values.reduce((total, value) => total + value, 0);
}

function shift(points, dx, dy) {
  for (const point of points) {
    point[0] += dx;
    point[1] += dy;
  }
}

document.addEventListener("DOMContentLoaded", async () => {
  const world = JSON.parse(byId("world").textContent);
  byId("unit").textContent = byId("speed-unit").textContent = world.unit;
  byId("task").textContent = world.task;
  const game = new Game(world, await readTrial(0));
  game.bind();
  window.game = game;
});
