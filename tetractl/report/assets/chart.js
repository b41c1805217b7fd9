// A line chart on a canvas: series over time, or over another axis, with a marker that follows.

const MARGIN = { left: 52, right: 10, top: 8, bottom: 30 };

class Chart {
  // series: [{ name, color, x, y }], a color being #rrggbb or, to follow the theme, one of page.css; options: { log, xLabel, yLabel, onSeek }
  constructor(canvas, options) {
    this.canvas = canvas;
    this.options = options;
    this.series = [];
    if (options.onSeek) {
      const seek = (event) => {
        const box = canvas.getBoundingClientRect();
        const share = (event.clientX - box.left - MARGIN.left) / (box.width - MARGIN.left - MARGIN.right);
        options.onSeek(this.low + Math.min(Math.max(share, 0), 1) * (this.high - this.low));
      };
      canvas.addEventListener("pointerdown", (event) => {
        canvas.setPointerCapture(event.pointerId);
        seek(event);
      });
      canvas.addEventListener("pointermove", (event) => {
        if (event.buttons) seek(event);
      });
    }
    canvas.addEventListener("pointermove", (event) => {
      const box = canvas.getBoundingClientRect();
      this.hover = event.clientX - box.left;
      this.draw();
    });
    canvas.addEventListener("pointerleave", () => {
      this.hover = undefined;
      this.draw();
    });
  }

  show(series, low, high) {
    this.series = series;
    this.low = low;
    this.high = high > low ? high : low + 1;
    const finite = [];
    for (const { y } of series)
      for (const value of y) if (Number.isFinite(value) && (!this.options.log || value > 0)) finite.push(value);
    let least = this.options.log ? Infinity : 0, most = -Infinity;
    for (const value of finite) {
      least = Math.min(least, value);
      most = Math.max(most, value);
    }
    if (!(most > -Infinity)) [least, most] = this.options.log ? [1, 10] : [0, 1];
    if (this.options.log) {
      this.bottom = Math.floor(Math.log10(Math.max(least, most * 1e-9)));
      this.top = Math.max(Math.ceil(Math.log10(most)), this.bottom + 1);
    } else {
      this.bottom = least;
      this.top = most > least ? most * 1.05 : least + 1;
    }
  }

  mark(value) {
    this.marker = value;
    this.draw();
  }

  draw() {
    const { context, width, height } = prepare(this.canvas);
    if (width <= 0 || this.low === undefined) return;
    const inner = { width: width - MARGIN.left - MARGIN.right, height: height - MARGIN.top - MARGIN.bottom };
    const px = (x) => MARGIN.left + ((x - this.low) / (this.high - this.low)) * inner.width;
    const level = (y) => (this.options.log ? Math.log10(Math.max(y, 10 ** this.bottom)) : y);
    const py = (y) => MARGIN.top + (1 - (level(y) - this.bottom) / (this.top - this.bottom)) * inner.height;
    this.axes(context, px, py, width, height, inner);
    for (const { x, y, color: ink, dashed } of this.series) {
      context.beginPath();
      let pen = false;
      for (let i = 0; i < x.length; i++) {
        if (!Number.isFinite(y[i])) { pen = false; continue; }
        if (pen) context.lineTo(px(x[i]), py(y[i])); else context.moveTo(px(x[i]), py(y[i]));
        pen = true;
      }
      context.strokeStyle = paint(ink);
      context.lineWidth = 1.6;
      context.setLineDash(dashed ? [4, 3] : []);
      context.stroke();
      context.setLineDash([]);
    }
    if (this.marker !== undefined) {
      context.fillStyle = color("ink");
      context.globalAlpha = 0.6;
      context.fillRect(px(this.marker) - 0.5, MARGIN.top, 1, inner.height);
      context.globalAlpha = 1;
    }
    if (this.hover !== undefined) this.values(context, px, py, width, inner);
  }

  axes(context, px, py, width, height, inner) {
    context.font = "11px system-ui, sans-serif";
    context.textBaseline = "middle";
    context.textAlign = "right";
    const levels = this.options.log
      ? ticks(this.bottom, this.top, 4).filter(Number.isInteger).map((power) => 10 ** power)
      : ticks(this.bottom, this.top, 4);
    const plain = levels[0] >= 0.009 && levels.at(-1) < 1.1e4; // all of an axis are written alike
    for (const y of levels) {
      context.fillStyle = color("grid");
      context.fillRect(MARGIN.left, Math.round(py(y)), inner.width, 1);
      context.fillStyle = color("quiet");
      context.fillText(this.options.log ? power(y, plain) : digits(y, 4), MARGIN.left - 6, py(y));
    }
    context.textAlign = "center";
    context.textBaseline = "top";
    for (const x of ticks(this.low, this.high, width / 90)) {
      context.fillStyle = color("quiet");
      context.fillRect(Math.round(px(x)), height - MARGIN.bottom, 1, 4);
      context.fillText(digits(x, 4), px(x), height - MARGIN.bottom + 5);
    }
    context.textAlign = "right";
    context.textBaseline = "alphabetic";
    context.fillText(this.options.xLabel, width - MARGIN.right, height - 2);
  }

  // The values under the pointer, in a small box.
  values(context, px, py, width, inner) {
    const at = this.low + ((this.hover - MARGIN.left) / inner.width) * (this.high - this.low);
    if (at < this.low || at > this.high) return;
    const lines = [[color("ink"), `${this.options.xLabel}: ${digits(at)}`]];
    for (const { name, color: ink, x, y } of this.series) {
      const i = indexAt(x, at);
      if (i >= 0) lines.push([paint(ink), `${name} ${digits(y[i])}`]);
    }
    context.font = "11px system-ui, sans-serif";
    const wide = Math.max(...lines.map(([, text]) => context.measureText(text).width)) + 12;
    const left = this.hover + wide + 14 > width ? this.hover - wide - 8 : this.hover + 8;
    context.fillStyle = color("quiet");
    context.fillRect(this.hover, MARGIN.top, 1, inner.height);
    context.fillStyle = color("page");
    context.strokeStyle = color("faint");
    context.fillRect(left, MARGIN.top, wide, 15 * lines.length + 6);
    context.strokeRect(left, MARGIN.top, wide, 15 * lines.length + 6);
    context.textAlign = "left";
    context.textBaseline = "top";
    lines.forEach(([ink, text], i) => {
      context.fillStyle = ink;
      context.fillText(text, left + 6, MARGIN.top + 5 + 15 * i);
    });
  }
}

function paint(ink) {
  return ink.startsWith("#") ? ink : color(ink);
}

function power(value, plain) {
  if (plain) return digits(value, 5);
  const raised = { "-": "⁻", 0: "⁰", 1: "¹", 2: "²", 3: "³", 4: "⁴", 5: "⁵", 6: "⁶", 7: "⁷", 8: "⁸", 9: "⁹" };
  return `10${[...String(Math.round(Math.log10(value)))].map((digit) => raised[digit]).join("")}`;
}
