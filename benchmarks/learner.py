"""Learn a policy for a spec, and compare it with the spec's own controller on unseen trials.

    python benchmarks/learner.py experiments/benchmark/one-cell.yaml --within 50
    python benchmarks/learner.py experiments/three_m3pi_bench.yaml --within 100 --trials 20

The learner is that of docs/how-to/step-by-step.md: PPO, by stable-baselines3. The policy kept
is the one that does best without the noise by which PPO explores, since the exported one has none,
on seeds of neither the learner nor the spec. It runs as the controller `policy`, and its logs are
verified. A trial succeeds if each robot ends within `--within` of its target [length unit], and
none entered an obstacle or left the arena.
"""

import argparse
import json
import time
from pathlib import Path

import tetractl
from tetractl.gym import TrialEnv

SHARE = 0.8
"""Tolerance of the episodes, as a share of `--within`: a robot drives on for up to a period."""
ENVIRONMENTS = 8
SEED = 1000
"""Of the learner; the trials of the comparison have the spec's seed."""
OTHER_SEED = 5000
"""Of the trials by which the best policy is chosen."""


def learn(spec, steps, gamma, folder):
    """Train on fresh seeds, and write the weights; return the processor time [s]."""
    import torch
    from stable_baselines3 import PPO
    from stable_baselines3.common.callbacks import EvalCallback
    from stable_baselines3.common.env_util import make_vec_env

    torch.set_num_threads(1)
    began_s = time.process_time()
    envs = make_vec_env(TrialEnv, ENVIRONMENTS, seed=SEED, env_kwargs={"spec": spec})
    others = make_vec_env(TrialEnv, seed=OTHER_SEED, env_kwargs={"spec": spec})
    check = EvalCallback(
        others, n_eval_episodes=40, eval_freq=1280, best_model_save_path=str(folder), verbose=0
    )
    learner = PPO(
        "MlpPolicy",
        envs,
        learning_rate=lambda remaining: 5e-4 * (1 + remaining),
        n_steps=256,
        gamma=gamma,
        seed=SEED,
        device="cpu",
    )
    learner.learn(steps, check)
    best = PPO.load(folder / "best_model").policy
    tetractl.write_weights(
        folder / "weights.json", [*best.mlp_extractor.policy_net, best.action_net]
    )
    return time.process_time() - began_s


def policy(control, weights):
    """Return the controller `policy` with the period, tolerance and time of another, as text for
    `--set`."""
    fields = {
        "type": "policy",
        "weights": str(weights.resolve()),
        "period": control.period,
        "arrival_tolerance": control.arrival_tolerance,
        "time_limit": control.time_limit,
    }
    return f"controller={json.dumps(fields)}"


def hit(trial):
    """Return whether a robot entered an obstacle or left the arena in a trial."""
    verdict = trial.result.verdict
    return any(verdict.entered) or any(edge < 0 for edge in verdict.edge)


def near(trial, within):
    """Return whether each robot ended near its target."""
    return max(trial.result.robot_errors) <= within


def row(name, batch, within):
    """Return a line of the comparison: successes, errors with an interval, what was hit, and logs
    that `verify` accepts."""
    trials = batch.trials
    count = len(trials)
    successes = sum(near(trial, within) and not hit(trial) for trial in trials)
    hits = sum(hit(trial) for trial in trials)
    total = tetractl.summarise(batch, name).total
    verified = sum(not tetractl.verify(trial.log).problems for trial in trials)
    error = f"{total.mean:.3g} [{total.ci95.low:.3g}, {total.ci95.high:.3g}]"
    return (
        f"{name:10} {successes} of {count} succeed, {hits} hit something; total error {error};"
        f" verify ok: {verified} of {count}"
    )


def main():
    """Learn, compare, and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("spec", type=Path)
    parser.add_argument("--within", type=float, default=50.0)
    parser.add_argument("--steps", type=int, default=40_000)
    parser.add_argument("--gamma", type=float, default=0.99)
    parser.add_argument("--trials", type=int, default=100)
    parser.add_argument("--set", action="append", default=[], dest="sets")
    parser.add_argument("--out", type=Path, default=Path("logs/learner"))
    args = parser.parse_args()
    tolerance = f"controller.arrival_tolerance={SHARE * args.within}"
    spec = tetractl.load_spec(args.spec, *args.sets, tolerance)
    args.out.mkdir(parents=True)
    learnt_s = learn(spec, args.steps, args.gamma, args.out)
    print(f"learnt {args.steps} steps in {learnt_s:.0f} s of processor time", flush=True)
    count = f"trials.count={args.trials}"
    arms = {
        "policy": tetractl.load_spec(
            args.spec, count, policy(spec.experiment.controller, args.out / "weights.json")
        ),
        "as shipped": tetractl.load_spec(args.spec, count),
    }
    for name, arm in arms.items():
        batch = tetractl.run_batch(arm, args.out / name, progress=False)
        print(row(name, batch, args.within), flush=True)


if __name__ == "__main__":
    main()
