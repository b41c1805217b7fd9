// The top view of the arena on a canvas.

function color(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
}

// Size a canvas for the screen's pixels and return its context and its size in CSS pixels.
function prepare(canvas) {
  const ratio = window.devicePixelRatio || 1;
  const width = canvas.clientWidth, height = canvas.clientHeight;
  const wide = Math.round(width * ratio), high = Math.round(height * ratio);
  if (canvas.width !== wide || canvas.height !== high) {
    canvas.width = wide;
    canvas.height = high;
  }
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, width, height);
  return { context, width, height };
}

const EDGE = { left: 46, right: 20, top: 46, bottom: 26 }; // around the arena: ticks, and u above it
const PLACES = [[1, -1], [1, 1], [-1, -1], [-1, 1]]; // of a name: right or left, above or below

class Scene {
  constructor(canvas) {
    this.canvas = canvas;
    this.options = { plan: true, trail: true, follow: false, dotted: false, arrow: "u" };
    this.overlay = undefined; // draws more on the arena, by a context
  }

  // Show a trial; `drawn` is called when a picture of its dish has been decoded.
  show(trial, drawn) {
    this.trial = trial;
    this.pictures = (trial.dish ? trial.dish.jpeg : []).map((data) => {
      const image = new Image();
      image.onload = drawn;
      image.src = `data:image/jpeg;base64,${data}`;
      return image;
    });
  }

  // Make the canvas as high as the arena needs at the page's width.
  fit() {
    const [left, bottom, right, top] = this.trial.arena;
    const wide = this.canvas.clientWidth - EDGE.left - EDGE.right;
    const high = (wide * (top - bottom)) / (right - left);
    this.canvas.style.height = `${Math.round(high) + EDGE.top + EDGE.bottom}px`;
  }

  // The part of the plane in view: [left, bottom, right, top].
  view(poses) {
    const [left, bottom, right, top] = this.trial.arena;
    if (!this.options.follow) return [left, bottom, right, top];
    const seen = poses.filter(([x, y]) => Number.isFinite(x + y));
    if (!seen.length) return [left, bottom, right, top];
    const xs = seen.map((p) => p[0]), ys = seen.map((p) => p[1]);
    const half = Math.max(
      Math.max(...xs) - Math.min(...xs), Math.max(...ys) - Math.min(...ys), 0.2 * (right - left)) * 0.65;
    const cx = (Math.max(...xs) + Math.min(...xs)) / 2, cy = (Math.max(...ys) + Math.min(...ys)) / 2;
    return [cx - half, cy - half, cx + half, cy + half];
  }

  draw(t) {
    this.fit();
    const { context, width, height } = prepare(this.canvas);
    const poses = posesAt(this.trial, t);
    const [left, bottom, right, top] = this.view(poses);
    const wide = width - EDGE.left - EDGE.right, high = height - EDGE.top - EDGE.bottom;
    const scale = Math.min(wide / (right - left), high / (top - bottom));
    const dx = EDGE.left + (wide - scale * (right - left)) / 2;
    const dy = EDGE.bottom + (high - scale * (top - bottom)) / 2;
    this.place = (x, y) => [dx + (x - left) * scale, height - dy - (y - bottom) * scale];
    this.world = (px, py) => [left + (px - dx) / scale, bottom + (height - dy - py) / scale];
    this.end = dx + scale * (right - left);
    this.background(context, width, height, t);
    if (this.options.trail) this.trails(context, t);
    this.targets(context);
    if (this.options.plan && this.trial.plan) this.plan(context, t);
    this.overlay?.(context);
    this.robots(context, poses);
    this.direction(context, t);
  }

  line(context, points, closed = false) {
    context.beginPath();
    let pen = false;
    for (const [x, y] of points) {
      if (!Number.isFinite(x + y)) { pen = false; continue; }
      const [px, py] = this.place(x, y);
      if (pen) context.lineTo(px, py); else context.moveTo(px, py);
      pen = true;
    }
    if (closed) context.closePath();
  }

  // The microscope's newest picture by time t, between its three corners.
  dish(context, t) {
    const { t: times, corners } = this.trial.dish;
    let which = 0;
    while (which + 1 < times.length && times[which + 1] <= t) which += 1;
    const image = this.pictures[which];
    if (!image.complete || !image.naturalWidth) return;
    const [[lx, ly], [rx, ry], [ux, uy]] = corners.map(([x, y]) => this.place(x, y));
    context.save();
    context.clip();
    context.transform(rx - lx, ry - ly, lx - ux, ly - uy, ux, uy);
    context.globalAlpha = 0.55;
    context.drawImage(image, 0, 0, 1, 1);
    context.restore();
  }

  // Draw what lies below the robots. While it stays the same, a picture of it is copied.
  background(context, width, height, t) {
    if (this.trial.dish || this.options.follow) {
      this.ground(context, width, t);
      return;
    }
    const { canvas, trial: { arena, obstacles } } = this;
    const looks = JSON.stringify([canvas.width, canvas.height, arena, obstacles, color("arena")]);
    if (looks !== this.looks) {
      this.looks = looks;
      this.still = document.createElement("canvas");
      this.still.width = canvas.width;
      this.still.height = canvas.height;
      const still = this.still.getContext("2d");
      still.setTransform(context.getTransform());
      this.ground(still, width, t);
    }
    context.drawImage(this.still, 0, 0, width, height);
  }

  ground(context, width, t) {
    const [left, bottom, right, top] = this.trial.arena;
    this.line(context, [[left, bottom], [right, bottom], [right, top], [left, top]], true);
    context.fillStyle = color("arena");
    context.fill();
    if (this.trial.dish) this.dish(context, t);
    this.line(context, [[left, bottom], [right, bottom], [right, top], [left, top]], true);
    context.strokeStyle = color("faint");
    context.lineWidth = 1;
    context.stroke();
    context.fillStyle = color("quiet");
    context.font = "11px system-ui, sans-serif";
    context.textAlign = "center";
    context.textBaseline = "top";
    for (const x of ticks(left, right, 5)) {
      const [px, py] = this.place(x, bottom);
      context.fillRect(px, py, 1, 4);
      const half = context.measureText(digits(x, 6)).width / 2;
      context.fillText(digits(x, 6), Math.min(px, width - half - 2), py + 6);
    }
    context.textAlign = "right";
    context.textBaseline = "middle";
    for (const y of ticks(bottom, top, 5).slice(1)) {
      const [px, py] = this.place(left, y);
      context.fillRect(px - 4, py, 4, 1);
      context.fillText(digits(y, 6), px - 6, py);
    }
    context.fillStyle = color("obstacle");
    context.strokeStyle = color("obstacle-edge");
    for (const outline of this.trial.obstacles) {
      this.line(context, outline, true);
      context.fill();
      context.stroke();
    }
  }

  // Targets as squares, way-points as smaller ones, starts and the edge of a hold as rings.
  targets(context) {
    const half = 7;
    const square = ([x, y], reach) => context.strokeRect(x - reach, y - reach, 2 * reach, 2 * reach);
    const ring = ([x, y], radius) => {
      context.beginPath();
      context.arc(x, y, radius, 0, 2 * Math.PI);
      context.stroke();
    };
    const letters = robotLetters(this.trial.robots);
    context.font = "600 9px system-ui, sans-serif";
    context.textAlign = "center";
    context.textBaseline = "middle";
    this.trial.robots.forEach((robot, r) => {
      context.strokeStyle = robot.color;
      context.lineWidth = 2;
      const target = this.place(...robot.target);
      square(target, half);
      context.fillStyle = color("ink");
      context.fillText(letters[r], target[0], target[1] + 0.5);
      context.lineWidth = 1.2;
      for (const point of robot.via) square(this.place(...point), half / 2);
      if (this.trial.hold) {
        const [edge] = this.place(robot.target[0] + this.trial.hold, robot.target[1]);
        ring(target, Math.abs(edge - target[0]));
      }
      ring(this.place(...robot.start), 4);
    });
  }

  trails(context, t) {
    const { t: times, xy } = this.trial.frames;
    const past = xy.slice(0, indexAt(times, t) + 1);
    context.lineWidth = 1.8;
    context.globalAlpha = 0.6;
    this.trial.robots.forEach((robot, r) => {
      this.line(context, past.map((poses) => poses[r]));
      context.strokeStyle = robot.color;
      context.stroke();
    });
    context.globalAlpha = 1;
  }

  plan(context, t) {
    const k = indexAt(this.trial.steps.t, t);
    if (k < 0) return;
    this.paths(context, this.trial.plan[k], this.options.dotted);
  }

  // Positions that robots will pass, (H, N, 2), as dashed lines or, if `dotted`, as dots.
  paths(context, positions, dotted) {
    context.lineWidth = dotted ? 4 : 1.4;
    context.lineCap = dotted ? "round" : "butt";
    context.setLineDash(dotted ? [0, 9] : [4, 4]);
    this.trial.robots.forEach((robot, r) => {
      this.line(context, positions.map((poses) => poses[r]));
      context.strokeStyle = robot.color;
      context.stroke();
    });
    context.setLineDash([]);
    context.lineCap = "butt";
  }

  robots(context, poses) {
    const size = 9;
    context.font = "600 12px system-ui, sans-serif";
    context.textAlign = "left";
    context.textBaseline = "middle";
    poses.forEach(([x, y, heading], r) => {
      if (!Number.isFinite(x + y)) return;
      const robot = this.trial.robots[r], [px, py] = this.place(x, y);
      context.save();
      context.translate(px, py);
      context.rotate(-heading);
      context.beginPath();
      context.moveTo(size * 1.5, 0);
      context.lineTo(-size, size * 0.85);
      context.lineTo(-size * 0.5, 0);
      context.lineTo(-size, -size * 0.85);
      context.closePath();
      context.fillStyle = robot.color;
      context.strokeStyle = color("page");
      context.lineWidth = 1.5;
      context.stroke();
      context.fill();
      context.restore();
    });
    this.names(context, poses);
  }

  // Write each robot's name where it hides nothing, to its upper right if that is as good.
  names(context, poses) {
    const { obstacles, robots, arena: [left, bottom, right, top] } = this.trial;
    const corner = [this.place(left, top), this.place(right, bottom)];
    const solid = obstacles.map((outline) => box(outline.map(([x, y]) => this.place(x, y)), 2));
    const marks = [...poses, ...robots.map((robot) => robot.target)]
      .map(([x, y]) => box([this.place(x, y)], 9));
    const taken = this.labels = [];
    context.textAlign = "left";
    poses.forEach(([x, y], r) => {
      if (!Number.isFinite(x + y)) return;
      const [px, py] = this.place(x, y), wide = context.measureText(robots[r].name).width;
      const around = PLACES.map(([right, down]) => {
        const from = px + (right > 0 ? 13 : -13 - wide);
        return { left: from, right: from + wide, top: py + down * 15 - 7, bottom: py + down * 15 + 7 };
      });
      const hides = around.map((one, i) =>
        [...solid, ...marks, ...taken].filter((other) => meet(one, other)).length
        + (one.left < corner[0][0] || one.right > corner[1][0] || one.top < corner[0][1] || one.bottom > corner[1][1])
        + 0.1 * i);
      const best = around[hides.indexOf(Math.min(...hides))];
      taken.push(best);
      context.strokeStyle = color("arena");
      context.lineWidth = 3;
      context.strokeText(robots[r].name, best.left, (best.top + best.bottom) / 2);
      context.fillStyle = color("ink");
      context.fillText(robots[r].name, best.left, (best.top + best.bottom) / 2);
    });
  }

  // The common direction u as an arrow above the arena.
  direction(context, t) {
    const k = indexAt(this.trial.steps.t, t);
    if (k < 0) return;
    const u = this.trial.steps.u[k], x = this.end - 20, y = EDGE.top / 2, reach = 20;
    if (Number.isNaN(u)) return;  // the field is off
    context.strokeStyle = context.fillStyle = color("ink");
    context.lineWidth = 2;
    context.save();
    context.translate(x, y);
    context.rotate(-u);
    context.beginPath();
    context.moveTo(-reach, 0); context.lineTo(reach - 4, 0);
    context.stroke();
    context.beginPath();
    context.moveTo(reach, 0); context.lineTo(reach - 9, 5); context.lineTo(reach - 9, -5);
    context.closePath();
    context.fill();
    context.restore();
    const name = this.options.arrow;
    context.font = name.length > 1 ? "13px system-ui, sans-serif" : "italic 13px serif";
    context.textAlign = "right";
    context.textBaseline = "middle";
    context.fillText(name, x - 28, y);
  }
}

// The rectangle round some points, larger by a margin.
function box(points, margin) {
  const xs = points.map(([x]) => x), ys = points.map(([, y]) => y);
  return {
    left: Math.min(...xs) - margin, right: Math.max(...xs) + margin,
    top: Math.min(...ys) - margin, bottom: Math.max(...ys) + margin,
  };
}

function meet(one, other) {
  return one.left < other.right && other.left < one.right && one.top < other.bottom && other.top < one.bottom;
}
