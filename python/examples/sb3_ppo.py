"""Stable-Baselines3's PPO on Hover, as it comes: pip install stable-baselines3.

python python/examples/sb3_ppo.py [steps]
"""

import sys

import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecNormalize

import omnidrones
from omnidrones.sb3 import VecEnv

n_step = int(float(sys.argv[1])) if len(sys.argv) > 1 else 5_000_000
torch.set_num_threads(1)
batch = VecEnv("Hover", 512, seed=0, threads=1, stagger=True)
env = VecNormalize(batch, gamma=0.985)
network = dict(net_arch=[64, 64], activation_fn=torch.nn.ELU, log_std_init=-0.5)
model = PPO(
    "MlpPolicy",
    env,
    n_steps=64,
    batch_size=2048,
    n_epochs=4,
    learning_rate=lambda left: 1e-3 * left,
    gamma=0.985,
    gae_lambda=0.98,
    max_grad_norm=1.0,
    policy_kwargs=network,
    seed=0,
    device="cpu",
)
with torch.no_grad():  # begin about the command that carries the weight
    model.policy.action_net.bias.copy_(torch.from_numpy(batch.batch.safe_command))
model.learn(n_step)


def policy(observation):
    """For the library's own starts, one agent each."""
    actions = model.predict(env.normalize_obs(observation[:, 0]), deterministic=True)[0]
    return np.ascontiguousarray(actions[:, None], np.float32)


figures = omnidrones.evaluate(policy, "Hover")
print(f"success from unseen starts: {figures['success']:.3f}, last error {figures['final_error']:.3f} m")
