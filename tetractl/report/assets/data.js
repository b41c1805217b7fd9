// Trials as they stand in the page: text that report/trial_data.py packs, where null stands for NaN.

async function readTrial(index) {
  const text = document.getElementById(`trial-data-${index}`).textContent;
  const bytes = Uint8Array.from(atob(text), (char) => char.charCodeAt(0));
  const plain = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  const trial = JSON.parse(await new Response(plain).text(), (_, value) => value ?? NaN);
  trial.start = 0;  // frames before the first direction give the poses there
  return trial;
}

// The index of the last of some rising times that is not after t, -1 if all are.
function indexAt(times, t) {
  let low = 0, high = times.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (times[middle] <= t) low = middle + 1; else high = middle;
  }
  return low - 1;
}

function angleBetween(one, other, share) {
  const turn = Math.atan2(Math.sin(other - one), Math.cos(other - one));
  return one + share * turn;
}

// Whether the poses and errors at a time are those of the result.
function isFinal(trial, t) {
  return trial.final && t >= trial.end;
}

// Poses [x, y, heading] of all robots at a time, between two frames by interpolation.
function posesAt(trial, t) {
  const { t: times, xy, heading } = trial.frames;
  const i = Math.max(indexAt(times, t), 0), j = Math.min(i + 1, times.length - 1);
  const gap = times[j] - times[i];
  const share = gap > 0 ? Math.min(Math.max((t - times[i]) / gap, 0), 1) : 0;
  return trial.robots.map((_, r) => {
    const mix = (k) =>
      isFinal(trial, t) ? trial.final.xy[r][k] : xy[i][r][k] + share * (xy[j][r][k] - xy[i][r][k]);
    return [mix(0), mix(1), angleBetween(heading[i][r], heading[j][r], share)];
  });
}

// The robots' distances to their targets at poses [x, y, ...].
function gaps(trial, poses) {
  return poses.map(([x, y], r) => {
    const [tx, ty] = trial.robots[r].target;
    return Math.hypot(x - tx, y - ty);
  });
}

function distancesAt(trial, t) {
  return isFinal(trial, t) ? trial.final.errors : gaps(trial, posesAt(trial, t));
}

function digits(value, count = 3) {
  if (value === null || !Number.isFinite(value)) return "–";
  const whole = Math.abs(value) >= 10 ** count;
  return whole ? value.toFixed(0) : String(Number(value.toPrecision(count)));
}

// Ticks at 1, 2 or 5 times a power of ten, about `count` of them.
function ticks(low, high, count) {
  const rough = (high - low) / Math.max(count, 1);
  if (!(rough > 0)) return [low];
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((m) => m * power).find((s) => s >= rough);
  const found = [];
  for (let k = Math.ceil(low / step); k * step <= high + step * 1e-9; k++) found.push(k * step);
  return found;
}
