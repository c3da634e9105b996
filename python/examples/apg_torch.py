"""A policy that hovers, learnt in PyTorch by exact gradients through the environment's steps: pip install torch.

python python/examples/apg_torch.py [updates] [device]   # cuda; cpu unless given
"""

import sys
import time

import torch

import omnidrones
from omnidrones.torch import Rollout, captured

N_ENV, WINDOW = 64, 48
updates = int(sys.argv[1]) if len(sys.argv) > 1 else 800
device = sys.argv[2] if len(sys.argv) > 2 else "cpu"

torch.manual_seed(0)
torch.set_num_threads(1)
env = omnidrones.make("Hover", N_ENV, device=device, seed=0, threads=1, stagger=True)
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
rollout = Rollout(env, WINDOW)
there = rollout.tensors.device
network.to(there)
optimiser = torch.optim.Adam(network.parameters(), 1e-2, betas=(0.9, 0.99))
schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, updates, 1e-4)


def window():
    """The mean loss of a window, and its gradient by the weights: on a card one piece of work."""
    rollout.begin()
    observation, cost = rollout.tensors.observation.clone(), torch.zeros((), device=there)
    for t in range(WINDOW):
        observation, _, loss, terminated, _ = rollout.step(network(observation))
        # what ends early goes on costing what it did last to the end of the window: no end is worth seeking
        cost = cost + (loss * torch.where(terminated, WINDOW - t, 1)).mean() / WINDOW
    optimiser.zero_grad()
    cost.backward()
    return cost.detach()


def policy(observation):
    """For arrays of the host."""
    with torch.no_grad():
        return network(torch.from_numpy(observation).to(there)).cpu().numpy()


env.reset()
descend, began = captured(window, rollout.tensors), time.perf_counter()
for update in range(updates):
    cost = descend()
    torch.nn.utils.clip_grad_norm_(network.parameters(), 0.2)
    optimiser.step()
    schedule.step()
    if update % 200 == 0:
        print(f"update {update:4}  loss {cost.item():.3f}", flush=True)
print(f"{updates * N_ENV * WINDOW / (time.perf_counter() - began):,.0f} steps with gradient per second")
print(f"success from unseen starts: {omnidrones.evaluate(policy, 'Hover')['success']:.3f}")
