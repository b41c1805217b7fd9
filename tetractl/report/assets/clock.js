// Runs a picture that moves: calls `advance` with the seconds that have passed, once a frame, while it
// returns true.
class FrameClock {
  constructor(advance) {
    this.advance = advance;
    this.running = false;
    this.frames = 0;
  }

  start() {
    if (this.running) return;
    this.running = true;
    let before = performance.now();
    const frame = (now) => {
      if (!this.running) return;
      const seconds = Math.max(now - before, 0) / 1000;
      before = now;
      this.frames++;
      if (this.advance(seconds)) requestAnimationFrame(frame); else this.running = false;
    };
    requestAnimationFrame(frame);
  }

  stop() {
    this.running = false;
  }
}
