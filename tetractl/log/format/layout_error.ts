import { Input } from "./types";

type Output = { total: number; robots: number[] };

// The targets, in the unit of the spec.
const targets = %TARGETS%;

export const inputs = ["%STEP%"];
export const output = "%ERROR%";

export default function script(event: Input<"%STEP%">): Output {
  const seen = event.message.observation as unknown as { x: number[]; y: number[] };
  const robots = targets.map(([x, y], i) => Math.hypot(seen.x[i] - x, seen.y[i] - y));
  return { total: robots.reduce((sum, error) => sum + error, 0), robots };
}
