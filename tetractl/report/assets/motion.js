// How a robot moves under a held direction: the paper's equations, as in tetractl/model/motion.

// The continuous motion (1)-(3) in closed form, after t seconds. A pose is [x, y, heading].
function moveExact([x, y, heading], u, a, v, t) {
  const half = (u - heading) / 2, c = Math.cos(half), s = Math.sin(half);
  const decay = Math.exp(-a * t);
  const turned = 2 * Math.atan2(-Math.expm1(-a * t) * s * c, c * c + s * s * decay);
  const fall = s * s * Math.expm1(-2 * a * t);
  const logH = fall > -0.5 ? Math.log1p(fall) : Math.log(c * c + (s * decay) ** 2);
  const along = v * (t + logH / a), right = (v * turned) / a;
  const cosU = Math.cos(u), sinU = Math.sin(u);
  return [x + along * cosU + right * sinU, y + along * sinU - right * cosU, heading + turned];
}

// The discrete model (4)-(6): a straight line along the heading at which the direction was received.
function moveEuler([x, y, heading], u, a, v, t) {
  return [
    x + v * t * Math.cos(heading),
    y + v * t * Math.sin(heading),
    heading + t * a * Math.sin(u - heading),
  ];
}

const MOTIONS = { exact: moveExact, euler: moveEuler };

// The signed distance of a point to a shape, negative inside: see tetractl/core/shape.py.
function distanceToShape({ corners, radius }, x, y) {
  let inside = false, least = Infinity;
  corners.forEach(([bx, by], i) => {
    const [ax, ay] = corners.at(i - 1), ex = bx - ax, ey = by - ay;
    const side = ex * (y - ay) - ey * (x - ax);
    if (side > 0 === by > ay && ay > y !== by > y) inside = !inside;
    const length2 = ex * ex + ey * ey;
    const along = Math.min(Math.max(((x - ax) * ex + (y - ay) * ey) / (length2 || 1), 0), 1);
    least = Math.min(least, Math.hypot(x - (ax + along * ex), y - (ay + along * ey)));
  });
  return (inside ? -least : least) - radius;
}
