"""CleanRL's PPO for continuous actions, its file untouched, learns Hover: CLEANRL=/path/of/a/clone .ci/python-heavy -k cleanrl."""

import os
import runpy
import sys
from pathlib import Path

import gymnasium
import numpy as np
import pytest

import omnidrones

torch = pytest.importorskip("torch")
pytest.importorskip("tyro", reason="not run: tyro is not here")
pytest.importorskip("tensorboard", reason="not run: tensorboard is not here")
SCRIPT = Path(os.environ.get("CLEANRL", "")) / "cleanrl" / "ppo_continuous_action.py"
STEPS = int(float(os.environ.get("CLEANRL_STEPS", "4e6")))


@pytest.mark.skipif(not SCRIPT.is_file(), reason="not run: CLEANRL names no clone of CleanRL (its package is for Gym, before Gymnasium)")
def test_cleanrls_ppo_learns_hover(tmp_path, monkeypatch):
    # its own options: more environments, for the width of the batch; all else as it comes
    options = ["--env-id", "omnidrones:Hover-v0", "--num-envs", "16", "--num-steps", "256", "--total-timesteps", str(STEPS)]
    monkeypatch.setattr(sys, "argv", [str(SCRIPT), *options])
    monkeypatch.chdir(tmp_path)
    torch.set_num_threads(1)
    left = runpy.run_path(str(SCRIPT), run_name="__main__")
    agent, env = left["agent"], left["envs"].envs[0]
    while not isinstance(env, gymnasium.wrappers.NormalizeObservation):
        env = env.env
    mean, spread = env.obs_rms.mean, np.sqrt(env.obs_rms.var + env.epsilon)

    def policy(observation):
        seen = np.clip((observation[:, 0] - mean) / spread, -10, 10)
        with torch.no_grad():
            actions = agent.actor_mean(torch.tensor(seen, dtype=torch.float32)).numpy()
        return np.ascontiguousarray(np.clip(actions, -1, 1)[:, None])

    told = omnidrones.evaluate(policy, "Hover")
    print(f"success {told['success']:.3f}, crashed {told['crashed']:.3f}, last error {told['final_error']:.3f} m")
    assert told["success"] >= 0.9, told
