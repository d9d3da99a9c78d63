"""Learns to grasp again from touch: where to grasp a bar next, and how strongly.

    python python/examples/learn_regrasp.py [--generations 6] [--population 16] [--episodes 6]

The policy has four numbers: motion along the bar per difference of the torques, and force by torque and
shear. The cross-entropy method improves them; each generation is one batch of grasps. Prints the mean
return and the fraction of episodes that end with a grasp that holds, first of random motions, then of
each generation's mean policy on bars that were not used for learning.
"""

import argparse
import time

import numpy as np
import numpy.typing as npt

from gripcast.gym import GraspVectorEnv

Floats = npt.NDArray[np.float64]
PARAMETERS = 4
HELD_OUT_SEED = 1_000_000


def act(policies: Floats, observations: Floats) -> npt.NDArray[np.float32]:
    """Motion and change of the force; a row per environment."""
    along = observations[:, 7] - observations[:, 6]
    turning = np.abs(along)
    slipping = np.abs(observations[:, [3, 5]]).sum(axis=1)
    motion = policies[:, 0] * along
    force = policies[:, 1] + policies[:, 2] * turning + policies[:, 3] * slipping
    return np.asarray(np.tanh(np.stack([motion, force], axis=1)), dtype=np.float32)


def evaluate(policies: Floats | None, envs: int, seed: list[int], max_grasps: int) -> tuple[Floats, Floats]:
    """Return and success of one episode per environment; random motions without policies."""
    env = GraspVectorEnv(envs, max_grasps=max_grasps)
    observations, _ = env.reset(seed=seed)
    random = np.random.default_rng(0)
    returns, holds = np.zeros(envs), np.zeros(envs)
    is_over = np.zeros(envs, dtype=bool)
    for _ in range(max_grasps):
        if policies is None:
            actions = random.uniform(-1, 1, (envs, 2)).astype(np.float32)
        else:
            actions = act(policies, observations.astype(np.float64))
        observations, rewards, terminated, truncated, _ = env.step(actions)
        returns += np.where(is_over, 0.0, rewards)
        holds[~is_over & terminated] = 1.0
        is_over |= terminated | truncated
        if is_over.all():
            break
    return returns, holds


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--generations", type=int, default=6)
    parser.add_argument("--population", type=int, default=16)
    parser.add_argument("--episodes", type=int, default=6)
    parser.add_argument("--max-grasps", type=int, default=3)
    arguments = parser.parse_args()
    population, episodes, max_grasps = arguments.population, arguments.episodes, arguments.max_grasps
    random = np.random.default_rng(0)
    began = time.monotonic()
    held_out = [HELD_OUT_SEED + i for i in range(4 * episodes)]

    def report(name: str, policy: Floats | None) -> None:
        policies = None if policy is None else np.tile(policy, (len(held_out), 1))
        returns, holds = evaluate(policies, len(held_out), held_out, max_grasps)
        print(
            f"{name:<14} return {returns.mean():6.3f}, {100 * holds.mean():3.0f} % hold, "
            f"{time.monotonic() - began:5.0f} s",
            flush=True,
        )

    report("random", None)
    mean, deviation = np.zeros(PARAMETERS), np.ones(PARAMETERS)
    for generation in range(1, arguments.generations + 1):
        candidates = mean + deviation * random.normal(size=(population, PARAMETERS))
        # All candidates get the same bars, new ones in each generation.
        seeds = [generation * 1000 + i for i in range(episodes)]
        policies = np.repeat(candidates, episodes, axis=0)
        returns, _ = evaluate(policies, population * episodes, seeds * population, max_grasps)
        scores = returns.reshape(population, episodes).mean(axis=1)
        best = candidates[np.argsort(scores)[-max(2, population // 4) :]]
        mean, deviation = best.mean(axis=0), best.std(axis=0) + 0.05
        report(f"generation {generation}", mean)
    print("policy", np.round(mean, 2))


if __name__ == "__main__":
    main()
