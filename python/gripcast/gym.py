"""Environments for Gymnasium: grasp again until the object holds. Needs `gripcast[gym]`.

A bar lies on a table. The gripper grasps it somewhere along its length, at a force, and lifts it a
little. Away from the middle the bar tilts, because its weight turns it in the grip; at a low force it
slips. The agent feels forces and torques of the grasp and says where and how strongly to grasp next.
Length, mass, friction and the first position differ between episodes and are not observed.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

import gripcast as gc

try:
    import gymnasium
    from gymnasium.utils import seeding
    from gymnasium.vector import AutoresetMode, VectorEnv
    from gymnasium.vector.utils import batch_space
except ImportError as _error:
    raise ImportError("gripcast.gym needs Gymnasium 1.1 or newer: pip install 'gripcast[gym]'") from _error

__all__ = ["GraspEnv", "GraspVectorEnv"]

_Array = npt.NDArray[np.float32]
_Range = tuple[float, float]
_Step = tuple[_Array, float, bool, bool, dict[str, Any]]

# What 1 means in an observation.
_FORCE_N = 10.0
_TORQUE_N_M = 0.05
_LIMIT = 10.0
# Largest motion along the bar between two grasps, and range of the stopping force.
_SHIFT_M = 0.04
_FORCES_N = (4.0, 20.0)
_FIRST_FORCE_N = 8.0
# Part of the bar's half length that can be grasped.
_REACH = 0.8
_WIDTH_M, _HEIGHT_M = 0.03, 0.04
# A grasp holds if the bar follows the lift and stays level.
_HOLDS_TILT_DEG = 2.0
_HOLDS_LIFT = 0.9
_GRASP_COST, _FORCE_COST_PER_N = 0.1, 0.01

_OBSERVATION = gymnasium.spaces.Box(-_LIMIT, _LIMIT, (10,), np.float32)
_ACTION = gymnasium.spaces.Box(-1.0, 1.0, (2,), np.float32)


def _bar(length_m: float) -> gc.Mesh:
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    faces = [
        (0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1),
        (2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3),
    ]  # fmt: skip
    return gc.Mesh.from_arrays(corners * (_WIDTH_M, length_m, _HEIGHT_M), faces)


class _Task:
    """Settings of an environment."""

    def __init__(
        self,
        *,
        max_grasps: int = 4,
        length_m: _Range = (0.11, 0.15),
        mass_kg: _Range = (0.15, 0.3),
        friction: _Range = (0.4, 0.7),
        gel: str = "coarse",
        lift_m: float = 0.016,
        dt_s: float = 0.02,
    ) -> None:
        if max_grasps < 1:
            raise gc.UsageError(f"`max_grasps` must be above 0, found {max_grasps}")
        for name, (low, high) in (("length_m", length_m), ("mass_kg", mass_kg), ("friction", friction)):
            if not 0.0 < low <= high < float("inf"):
                raise gc.UsageError(f"`{name}` must be a range above 0, found {low} to {high}")
        self.max_grasps = max_grasps
        self.length_m = length_m
        self.mass_kg = mass_kg
        self.friction = friction
        self.gel = gel
        self.lift_m = lift_m
        self.dt_s = dt_s


class _Episode:
    """One bar. `case` is what to simulate next, `score` takes the result."""

    def __init__(self, task: _Task, random: np.random.Generator) -> None:
        self._task = task
        length_m = random.uniform(*task.length_m)
        self._bar = gc.Object(
            _bar(length_m), mass_kg=random.uniform(*task.mass_kg), friction=random.uniform(*task.friction)
        )
        self._reach_m = _REACH * length_m / 2
        self._offset_m = random.uniform(-self._reach_m, self._reach_m)
        self._force_n = _FIRST_FORCE_N
        self._grasps = 0
        self.result: gc.GraspResult | None = None

    def move(self, action: Sequence[float] | _Array) -> None:
        """Takes an action: motion along the bar, change of the force."""
        shift, harder = np.clip(np.asarray(action, dtype=np.float64), -1.0, 1.0)
        self._offset_m = float(np.clip(self._offset_m + _SHIFT_M * shift, -self._reach_m, self._reach_m))
        self._force_n = float(np.clip(self._force_n * 2.0**harder, *_FORCES_N))

    def case(self) -> gc.GraspCase:
        task = self._task
        return gc.GraspCase(
            self._bar,
            gc.Placement(yaw_deg=0.0, offset_m=(0.0, self._offset_m)),
            gel=task.gel,  # type: ignore[arg-type]
            stop_force_n=self._force_n,
            adjust_s=0.1,
            lift_m=task.lift_m,
            dt_s=task.dt_s,
        )

    def score(self, result: gc.GraspResult) -> _Step:
        self.result = result
        self._grasps += 1
        holds = _holds(result, self._task.lift_m)
        reward = float(holds) - _GRASP_COST - _FORCE_COST_PER_N * self._force_n
        left = 1.0 - self._grasps / (self._task.max_grasps + 1)
        touch = [
            result.normal_force_n[-1] / _FORCE_N,
            result.shear_force_n[-1].ravel() / _FORCE_N,
            result.torque_n_m[-1] / _TORQUE_N_M,
            [self._force_n / _FORCE_N, left],
        ]
        observation = np.clip(np.concatenate(touch), -_LIMIT, _LIMIT).astype(np.float32)
        info = {"holds": holds, "offset_m": self._offset_m, "force_n": self._force_n, "outcome": result.outcome}
        return observation, reward, holds, self._grasps > self._task.max_grasps and not holds, info


def _holds(result: gc.GraspResult, lift_m: float) -> bool:
    if result.outcome not in ("success", "slip") or not len(result.t_s):
        return False
    first, last = result.t_world_object[0], result.t_world_object[-1]
    rotation = first[:3, :3].T @ last[:3, :3]
    tilt_deg = np.degrees(np.arccos(np.clip((np.trace(rotation) - 1.0) / 2.0, -1.0, 1.0)))
    return bool(tilt_deg < _HOLDS_TILT_DEG and result.lifted_m > _HOLDS_LIFT * lift_m)


class GraspEnv(gymnasium.Env[_Array, _Array]):
    """Grasps a bar again until it holds.

    observation: 10, float32: normal forces left, right; shear forces along y and z left, then right (in
    10 N); torques left, right (in 0.05 N m); stopping force (in 10 N); fraction of the grasps left.
    action: 2, float32, -1 to 1: motion along the bar (in 0.04 m), change of the stopping force (factor
    of 2). reward: 1 if the grasp holds, less 0.1 per grasp and 0.01 per N. The episode terminates when a
    grasp holds and is truncated after `max_grasps`. `reset` makes the first grasp, which never ends an
    episode. `render` (rgb_array) returns what the left gel sees.

    max_grasps: grasps after the first; length_m, mass_kg and friction: ranges of the bar; gel, lift_m and
    dt_s: as in `simulate`.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 1}

    def __init__(self, *, render_mode: str | None = None, **task: Any) -> None:
        if render_mode not in (None, "rgb_array"):
            raise gc.UsageError(f"`render_mode` must be rgb_array or None, found {render_mode!r}")
        self.render_mode = render_mode
        self.observation_space = _OBSERVATION
        self.action_space = _ACTION
        self._task = _Task(**task)
        self._episode: _Episode | None = None

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[_Array, dict[str, Any]]:
        """A new bar and its first grasp. Has no options."""
        super().reset(seed=seed)
        # A first grasp that holds leaves nothing to do.
        while True:
            self._episode = _Episode(self._task, self.np_random)
            observation, _, holds, _, info = self._grasp(self._episode)
            if not holds:
                return observation, info

    def step(self, action: _Array) -> _Step:
        """Grasps again."""
        episode = self._need_episode()
        episode.move(action)
        return self._grasp(episode)

    def render(self) -> Any:
        """What the left gel sees at the last grasp: 240 × 320 × 3, uint8, RGB; None without a mode."""
        if self.render_mode is None:
            return None
        result = self._need_episode().result
        assert result is not None
        touched = "adjustment" in result.snapshots
        return np.array(gc.render_tactile(result, moment="grasp" if touched else "initial", profile=_sensor()).image)

    def _grasp(self, episode: _Episode) -> _Step:
        (result,) = gc.simulate_batch([episode.case()], threads=1)
        return episode.score(result)

    def _need_episode(self) -> _Episode:
        if self._episode is None:
            raise gc.UsageError("the environment has no episode", None, "call reset() first")
        return self._episode


class GraspVectorEnv(VectorEnv[_Array, _Array, npt.NDArray[Any]]):
    """`num_envs` environments like `GraspEnv`, whose grasps run in `threads` threads (None: all cores).

    An environment whose episode has ended is reset by the next step.
    """

    metadata: dict[str, Any] = {"autoreset_mode": AutoresetMode.NEXT_STEP, "render_modes": []}

    def __init__(self, num_envs: int, *, threads: int | None = None, **task: Any) -> None:
        if num_envs < 1:
            raise gc.UsageError(f"`num_envs` must be above 0, found {num_envs}")
        self.num_envs = num_envs
        self.single_observation_space, self.single_action_space = _OBSERVATION, _ACTION
        self.observation_space = batch_space(_OBSERVATION, num_envs)
        self.action_space = batch_space(_ACTION, num_envs)
        self._task = _Task(**task)
        self._threads = threads
        self._random: list[np.random.Generator] = []
        self._episodes: dict[int, _Episode] = {}
        self._is_over = [False] * num_envs

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[_Array, dict[str, Any]]:
        """New bars and their first grasps. Environment i has the seed `seed` + i, or seed[i]."""
        if seed is None:
            seeds: list[int | None] = [None] * self.num_envs
        elif isinstance(seed, Sequence):
            seeds = list(seed)
        else:
            seeds = [int(seed) + i for i in range(self.num_envs)]
        if len(seeds) != self.num_envs:
            raise gc.UsageError(f"`seed` must have {self.num_envs} seeds, found {len(seeds)}")
        if not self._random or any(one is not None for one in seeds):
            self._random = [seeding.np_random(one)[0] for one in seeds]
        first = self._first(range(self.num_envs))
        self._is_over = [False] * self.num_envs
        each = [first[i] for i in range(self.num_envs)]
        return np.stack([step[0] for step in each]), _gathered([step[4] for step in each])

    def step(
        self, actions: _Array
    ) -> tuple[_Array, npt.NDArray[Any], npt.NDArray[Any], npt.NDArray[Any], dict[str, Any]]:
        """Grasps again; environments that had ended make their first grasp, with the reward 0."""
        if not self._episodes:
            raise gc.UsageError("the environments have no episodes", None, "call reset() first")
        actions = np.asarray(actions, dtype=np.float32).reshape(self.num_envs, 2)
        over = [i for i in range(self.num_envs) if self._is_over[i]]
        going = [i for i in range(self.num_envs) if not self._is_over[i]]
        for i in going:
            self._episodes[i].move(actions[i])
        steps = self._grasp(going)
        for i, (observation, _, _, _, info) in self._first(over).items():
            steps[i] = (observation, 0.0, False, False, info)
        observations, rewards, terminated, truncated, infos = zip(*(steps[i] for i in range(self.num_envs)))
        self._is_over = [ended or cut for ended, cut in zip(terminated, truncated)]
        return (
            np.stack(observations),
            np.array(rewards, dtype=np.float64),
            np.array(terminated, dtype=np.bool_),
            np.array(truncated, dtype=np.bool_),
            _gathered(infos),
        )

    def _first(self, envs: Iterable[int]) -> dict[int, _Step]:
        """New bars, each with a first grasp that does not hold."""
        done: dict[int, _Step] = {}
        left = list(envs)
        while left:
            self._episodes.update((i, _Episode(self._task, self._random[i])) for i in left)
            done.update((i, step) for i, step in self._grasp(left).items() if not step[2])
            left = [i for i in left if i not in done]
        return done

    def _grasp(self, envs: list[int]) -> dict[int, _Step]:
        results = gc.simulate_batch([self._episodes[i].case() for i in envs], threads=self._threads)
        return {i: self._episodes[i].score(result) for i, result in zip(envs, results)}


def _gathered(infos: Sequence[dict[str, Any]]) -> dict[str, Any]:
    return {name: np.array([info[name] for info in infos]) for name in infos[0]}


def _sensor() -> gc.SensorProfile:
    global _kept
    if _kept is None:
        _kept = gc.SensorProfile("gelsight-mini")
    return _kept


_kept: gc.SensorProfile | None = None

gymnasium.register(
    "gripcast/Grasp-v0",
    entry_point="gripcast.gym:GraspEnv",
    vector_entry_point="gripcast.gym:GraspVectorEnv",
)
