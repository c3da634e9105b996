"""A policy that hovers, learnt in PyTorch by exact gradients through the environment's steps: pip install torch.

python python/examples/apg_torch.py [updates]
"""

import sys
import time

import torch

import omnidrones

N_ENV, WINDOW = 64, 48
updates = int(sys.argv[1]) if len(sys.argv) > 1 else 800

torch.manual_seed(0)
torch.set_num_threads(1)
env = omnidrones.make("Hover", N_ENV, seed=0, threads=1, stagger=True)
spec = env.spec
network = torch.nn.Sequential(
    torch.nn.Linear(spec.n_observation, 64),
    torch.nn.Tanh(),
    torch.nn.Linear(64, 64),
    torch.nn.Tanh(),
    torch.nn.Linear(64, spec.n_action),
    torch.nn.Tanh(),
)
with torch.no_grad():  # begin about the command that carries the weight
    for layer in (network[0], network[2]):
        layer.weight.normal_(0.0, layer.in_features**-0.5)
        layer.bias.zero_()
    network[-2].weight.normal_(0.0, 0.01)
    network[-2].bias.copy_(torch.atanh(torch.from_numpy(env.safe_command)))
optimiser = torch.optim.Adam(network.parameters(), 1e-2, betas=(0.9, 0.99))
schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, updates, 1e-4)
rollout = omnidrones.torch.Rollout(env, WINDOW)


def policy(observation):
    """For NumPy arrays."""
    with torch.no_grad():
        return network(torch.from_numpy(observation)).numpy()


began = time.perf_counter()
observation = torch.from_numpy(env.reset().copy())
for update in range(updates):
    rollout.begin()
    observation, cost = observation.detach(), torch.zeros(())
    for t in range(WINDOW):
        observation, _, loss, terminated, _ = rollout.step(network(observation))
        # what ends early goes on costing what it did last to the end of the window: no end is worth seeking
        cost = cost + (loss * torch.where(terminated, WINDOW - t, 1)).mean() / WINDOW
    optimiser.zero_grad()
    cost.backward()
    torch.nn.utils.clip_grad_norm_(network.parameters(), 0.2)
    optimiser.step()
    schedule.step()
    if update % 200 == 0:
        print(f"update {update:4}  loss {cost.item():.3f}", flush=True)
print(f"{updates * N_ENV * WINDOW / (time.perf_counter() - began):,.0f} steps with gradient per second")
print(f"success from unseen starts: {omnidrones.evaluate(policy, 'Hover')['success']:.3f}")
