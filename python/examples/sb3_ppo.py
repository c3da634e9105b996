"""Stable-Baselines3's PPO on Hover, as it comes: pip install stable-baselines3.

python python/examples/sb3_ppo.py [steps]
"""

import sys

import numpy as np
import torch
from stable_baselines3 import PPO

import omnidrones
from omnidrones.sb3 import VecEnv

n_step = int(float(sys.argv[1])) if len(sys.argv) > 1 else 3_000_000
torch.set_num_threads(1)
env = VecEnv("Hover", 256, seed=0, threads=1, stagger=True)
model = PPO("MlpPolicy", env, n_steps=64, batch_size=2048, n_epochs=5, learning_rate=1e-3, seed=0, device="cpu")
with torch.no_grad():  # begin about the command that carries the weight
    model.policy.action_net.bias.copy_(torch.from_numpy(env.batch.safe_command))
model.learn(n_step)


def policy(observation):
    return np.clip(model.predict(observation[:, 0], deterministic=True)[0], -1, 1)[:, None]


print(f"success from unseen starts: {omnidrones.evaluate(policy, 'Hover')['success']:.3f}")
