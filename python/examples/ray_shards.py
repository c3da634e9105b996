"""A batch in two processes of Ray beside the same batch in one: pip install ray. On a cluster: ray start --head."""

import time

import numpy as np
import ray

import omnidrones

N_ENV, N_STEP = 4096, 100
ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False)
policy = omnidrones.train("Hover").policy

shards = omnidrones.ray.Shards("Hover", N_ENV, workers=2, seed=1)
env = omnidrones.make("Hover", N_ENV, seed=1, threads=1)
assert np.array_equal(shards.reset(), env.reset())
shards.rollout(policy, 1)
env.step(policy(env.observation))

began = time.perf_counter()
rows = shards.rollout(policy, N_STEP)
print(f"two workers: {N_ENV * N_STEP / (time.perf_counter() - began):,.0f} steps per second, rows sent")
began = time.perf_counter()
for t in range(N_STEP):
    assert np.array_equal(rows["observation"][t], env.observation)
    env.step(policy(env.observation))
print(f"one process: {N_ENV * N_STEP / (time.perf_counter() - began):,.0f} steps per second, compared bit for bit")
