// The player: time, keys, buttons; it has the scene, the charts and the table show an instant.

const byId = (id) => document.getElementById(id);

class Player {
  constructor(count) {
    this.count = count;
    this.scene = new Scene(byId("scene"));
    const seek = (t) => this.pauseAt(t);
    this.charts = {
      distance: new Chart(byId("chart-distance"), { xLabel: "time [s]", log: true, onSeek: seek }),
      cost: new Chart(byId("chart-cost"), { xLabel: "time [s]", log: true, onSeek: seek }),
      solve: new Chart(byId("chart-solve"), { xLabel: "time [s]", onSeek: seek }),
      history: new Chart(byId("chart-history"), { xLabel: "iteration", log: true }),
    };
    this.rate = 1;
    this.clock = new FrameClock((seconds) => this.advance(seconds));
  }

  get frames() { return this.clock.frames; }
  get playing() { return this.clock.running; }

  bind() {
    const on = (id, event, action) => byId(id).addEventListener(event, action);
    on("play", "click", () => this.toggle());
    on("step-back", "click", () => this.step(-1));
    on("step-on", "click", () => this.step(1));
    on("to-start", "click", () => this.pauseAt(this.trial.start));
    on("to-end", "click", () => this.pauseAt(this.trial.end));
    on("scrub", "input", ({ target: { value, step } }) =>
      this.pauseAt(Number(value) > this.trial.end - step ? this.trial.end : Number(value)));
    on("rate", "change", (event) => { this.rate = Number(event.target.value); });
    on("which", "change", (event) => this.open(Number(event.target.value)));
    for (const name of ["plan", "trail", "follow"])
      on(`show-${name}`, "change", (event) => {
        this.scene.options[name] = event.target.checked;
        this.draw();
      });
    on("theme", "click", () => {
      const dark = getComputedStyle(document.documentElement).colorScheme === "dark";
      document.documentElement.dataset.theme = dark ? "light" : "dark";
      this.draw();
    });
    document.querySelectorAll("svg.errors").forEach((drawing) => this.rove(drawing));
    document.addEventListener("keydown", (event) => this.key(event));
    window.addEventListener("resize", () => this.draw());
    window.addEventListener("beforeprint", () => this.draw());
    window.addEventListener("hashchange", () => this.follow());
    window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.draw());
    byId("scene").addEventListener("pointermove", (event) => this.point(event));
    byId("scene").addEventListener("pointerleave", () => { byId("pointed").textContent = ""; });
  }

  // Make the dots of a figure one stop of the Tab key; within it, arrow keys, Home and End move.
  rove(drawing) {
    const dots = [...drawing.querySelectorAll("a")];
    dots.forEach((dot, i) => dot.setAttribute("tabindex", i ? -1 : 0));
    drawing.addEventListener("keydown", (event) => {
      const now = dots.indexOf(event.target.closest("a")), last = dots.length - 1;
      const places = { ArrowRight: now + 1, ArrowDown: now + 1, ArrowLeft: now - 1, ArrowUp: now - 1, Home: 0, End: last };
      if (now < 0 || !(event.key in places)) return;
      event.preventDefault();
      event.stopPropagation(); // these keys also move the player
      const next = Math.min(Math.max(places[event.key], 0), last);
      dots[now].setAttribute("tabindex", -1);
      dots[next].setAttribute("tabindex", 0);
      dots[next].focus();
    });
  }

  // Open the trial that the address names, such as #trial-3.
  follow() {
    const found = /^#trial-(\d+)$/.exec(location.hash);
    if (!found || !(Number(found[1]) >= 1 && Number(found[1]) <= this.count)) return;
    this.open(Number(found[1]) - 1);
    byId("player").scrollIntoView();
  }

  key(event) {
    const tag = event.target.tagName;
    if (event.ctrlKey || event.metaKey || event.altKey || tag === "SELECT") return;
    if (tag === "INPUT" && event.target.type === "range" && event.key.startsWith("Arrow")) return;
    const actions = {
      " ": () => this.toggle(),
      ArrowLeft: () => this.pauseAt(this.time - 1),
      ArrowRight: () => this.pauseAt(this.time + 1),
      ",": () => this.step(-1),
      ".": () => this.step(1),
      Home: () => this.pauseAt(this.trial.start),
      End: () => this.pauseAt(this.trial.end),
      e: () => this.event(1),
      E: () => this.event(-1),
      "[": () => this.open(this.index - 1),
      "]": () => this.open(this.index + 1),
    };
    const buttons = tag === "BUTTON" || tag === "SUMMARY" || tag === "A" || tag === "INPUT";
    if (!(event.key in actions) || (event.key === " " && buttons)) return;
    event.preventDefault();
    actions[event.key]();
  }

  open(index) {
    if (index < 0 || index >= this.count) return;
    this.pause();
    this.index = index;
    this.opened = readTrial(index).then((trial) => {
      if (index === this.index) this.show(trial);  // else another was chosen meanwhile
    });
  }

  show(trial) {
    this.trial = trial;
    this.searched = undefined;
    byId("which").value = String(this.index);
    const scrub = byId("scrub");
    scrub.min = this.trial.start;
    scrub.max = this.trial.end;
    scrub.step = Math.max(this.trial.end / 2000, 1e-3);
    this.scene.show(this.trial, () => this.draw());
    this.tables();
    this.lines();
    this.time = this.trial.end;
    this.draw();
  }

  lines() {
    const { trial } = this, { steps } = trial;
    const { start, end } = trial;
    const x = trial.frames.t.filter((t) => t >= start);
    const distances = trial.frames.xy.slice(-x.length).map((poses) => gaps(trial, poses));
    const each = trial.robots.map((robot, r) => ({
      name: robot.name, color: robot.color, x, y: distances.map((those) => those[r]),
    }));
    const total = {
      name: "total", color: "whole", x, dashed: true,
      y: distances.map((those) => those.reduce((sum, one) => sum + one)),
    };
    this.charts.distance.show([...each, total], start, end);
    this.charts.cost.show([{ name: "J", color: "whole", x: steps.t, y: steps.cost }], start, end);
    const solve = [{ name: "solve", color: "whole", x: steps.t, y: steps.solve_ms }];
    this.charts.solve.show(solve, start, end);
  }

  tables() {
    const { trial } = this, letters = robotLetters(trial.robots);
    byId("robots").replaceChildren(...trial.robots.map((robot, r) => robotRow(robot, letters[r], 3)));
    byId("distance-unit").textContent = `[${trial.unit}]`;
    byId("outcome").textContent = trial.outcome + (trial.reason ? `: ${trial.reason}` : "");
    byId("file").textContent = trial.file;
    const marks = byId("marks"), list = byId("events");
    const place = (t) => `${(100 * (Math.min(t, trial.end) - trial.start)) / (trial.end - trial.start || 1)}%`;
    marks.replaceChildren(...trial.events.map(({ t, level, text }) => {
      const mark = document.createElement("i");
      mark.className = level;
      mark.style.left = place(t);
      mark.title = `${digits(t, 4)} s: ${text}`;
      return mark;
    }));
    list.replaceChildren(...trial.events.map(({ t, level, text }) => {
      const item = document.createElement("li"), jump = document.createElement("button");
      jump.textContent = `${(Math.abs(t) < 0.005 ? 0 : t).toFixed(2)} s`;
      jump.addEventListener("click", () => this.pauseAt(t));
      item.className = level;
      item.append(jump, ` ${text}`);
      return item;
    }));
    byId("no-events").hidden = trial.events.length > 0;
    byId("history-box").hidden = !trial.history;
  }

  toggle() {
    if (this.playing) { this.pause(); return; }
    if (this.time >= this.trial.end) this.time = this.trial.start;
    byId("play").textContent = "Pause";
    this.clock.start();
  }

  // Show the trial some seconds later; return whether it goes on then.
  advance(seconds) {
    this.time = Math.min(this.time + this.rate * seconds, this.trial.end);
    this.draw();
    if (this.time >= this.trial.end) this.pause();
    return this.playing;
  }

  pause() {
    this.clock.stop();
    byId("play").textContent = "Play";
    if (this.trial) byId("said").textContent = this.words();
  }

  pauseAt(t) {
    this.time = Math.min(Math.max(t, this.trial.start), this.trial.end);
    this.pause();
    this.draw();
  }

  step(by) {
    const times = this.trial.steps.t;
    const k = by > 0 ? indexAt(times, this.time) + 1 : indexAt(times, this.time - 1e-6);
    if (k >= 0 && k < times.length) this.pauseAt(times[k]);
  }

  event(by) {
    const times = this.trial.events.map((event) => event.t);
    const k = by > 0 ? indexAt(times, this.time) + 1 : indexAt(times, this.time - 1e-6);
    if (k >= 0 && k < times.length) this.pauseAt(times[k]);
  }

  words() {
    const { trial } = this, k = indexAt(trial.steps.t, this.time);
    const total = distancesAt(trial, this.time).reduce((sum, one) => sum + one, 0);
    const where = k < 0 ? "before the first step" : `step ${k}`;
    return `${this.time.toFixed(2)} s, ${where}, total error ${digits(total)} ${trial.unit}, ${this.known()}`;
  }

  // How the poses and errors shown are known.
  known() {
    return isFinal(this.trial, this.time) ? `${this.trial.final.known}, as in the tables` : "measured";
  }

  draw() {
    const { trial, time } = this, k = indexAt(trial.steps.t, time);
    this.scene.draw(time);
    for (const name of ["distance", "cost", "solve"]) this.charts[name].mark(time);
    this.search(k);
    const scrub = byId("scrub");
    scrub.value = time;
    scrub.setAttribute("aria-valuetext", this.words());
    const set = (id, text) => { byId(id).textContent = text; };
    set("time", `${time.toFixed(2)} s of ${trial.end.toFixed(2)} s`);
    set("step", k < 0 ? "–" : String(k));
    set("cost", k < 0 ? "–" : digits(trial.steps.cost[k]));
    set("signals", k < 0 ? "–" : digits(trial.steps.signals[k]));
    const u = k < 0 ? undefined : trial.steps.u[k];
    set("direction", u === undefined ? "–" : Number.isNaN(u) ? `none: ${trial.steps.doing[k]}` : `${((u * 180) / Math.PI).toFixed(0)}°`);
    set("solve", k < 0 ? "–" : `${digits(trial.steps.solve_ms[k])} ms`);
    set("stopped", k < 0 ? "–" : trial.steps.ended[k]);
    set("known", this.known());
    const poses = posesAt(trial, time), distances = distancesAt(trial, time);
    [...byId("robots").children].forEach((row, r) => {
      const [x, y] = poses[r];
      row.children[1].textContent = digits(distances[r]);
      row.children[2].textContent = digits(x, 4);
      row.children[3].textContent = digits(y, 4);
    });
    set("total", digits(distances.reduce((sum, one) => sum + one, 0)));
  }

  search(k) {
    if (!this.trial.history || k === this.searched) return;
    this.searched = k;
    const y = k < 0 ? [] : this.trial.history[k], x = [...y.keys()];
    this.charts.history.show([{ name: "J", color: "whole", x, y }], 0, x.at(-1) ?? 1);
    this.charts.history.draw();
  }

  point(event) {
    const box = byId("scene").getBoundingClientRect();
    let nearest = null, least = 18;
    posesAt(this.trial, this.time).forEach(([x, y, heading], r) => {
      if (!Number.isFinite(x + y)) return;
      const [px, py] = this.scene.place(x, y);
      const gap = Math.hypot(px - (event.clientX - box.left), py - (event.clientY - box.top));
      if (gap < least) [nearest, least] = [[r, x, y, heading], gap];
    });
    const { unit, robots } = this.trial;
    byId("pointed").textContent = nearest
      ? `${robots[nearest[0]].name}: x ${digits(nearest[1], 4)} ${unit}, y ${digits(nearest[2], 4)} ${unit},`
        + ` heading ${((nearest[3] * 180) / Math.PI).toFixed(0)}°`
      : "";
  }
}

document.addEventListener("DOMContentLoaded", async () => {
  const count = document.querySelectorAll('script[id^="trial-data-"]').length;
  if (!count) return;
  const player = new Player(count);
  player.open(0);
  await player.opened;
  player.bind();
  player.follow();
  window.player = player;
});
